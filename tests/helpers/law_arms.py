"""An arm, its estimator as a torch module, and what the sensors of arms built like it read."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import torch

from cablesense_sim import kinematics
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.tolerances import ArmParameters
from cablesense_sim.touch import TouchedPlaces, touched_places
from cablesense_sim.uncertain_arm import CableFriction
from cablesense_training.law.estimator import ArmEstimator

NOISE_STD_N = 0.05


@dataclass(frozen=True)
class Push:
    """A force along the axes that its segment, from 0 on, has at the command."""

    segment: int
    place_m: float
    force_n: tuple[float, float, float]


class LawArm:
    """The estimator of an arm, and the statics that it has to invert."""

    def __init__(
        self, arm, mechanism=None, wraps=(0.0, 0.0), radius_m=0.0, friction=0.0, run_compliance=0.5
    ):
        self.mechanism = mechanism_of(arm) if mechanism is None else mechanism
        self.parameters = ArmParameters(self.mechanism, arm.tolerances)
        count = self.mechanism.segment_count
        self.touched_m = touched_places(arm).touched_m
        self.estimator = ArmEstimator(
            self.mechanism,
            self.mechanism,
            self.parameters,
            NOISE_STD_N**2,
            CableFriction(0.0, *wraps, np.full(self.mechanism.cable_count, run_compliance)),
            TouchedPlaces(self.touched_m, np.full(count, radius_m), friction),
        )

    def at(self, kind):
        """Where the parameters of a kind stand, `carried_friction` being those of all guides."""
        parts = [part for name, part in self.parameters.slices.items() if name.startswith(kind)]
        return slice(parts[0].start, parts[-1].stop)

    def within_the_statics(self, values):
        """Parameters, or their deviations, with what the equilibrium does not have at zero.

        That is friction, and centres of mass beside the axes.
        """
        changed = values.copy()
        changed[self.at("centre_across")] = 0.0
        changed[self.at("carried_friction")] = 0.0
        changed[self.at("friction")] = 0.0
        changed[self.at("run_compliance")] = 0.0
        return changed

    def command(self, rng, largest_deg=10.0):
        return np.deg2rad(rng.uniform(-largest_deg, largest_deg, self.mechanism.joint_count))

    def rest(self, theta, command, pushes=()):
        """The equilibrium of the arm with these parameters, and the torques of pushes there."""
        built = self.parameters.built(theta)
        axes = kinematics.segment_rotations(self.mechanism, command[None])[0]
        places = built.contact_m.copy()
        forces = np.zeros((len(places), 3))
        for push in pushes:
            places[push.segment] = push.place_m
            forces[push.segment] = axes[push.segment] @ np.array(push.force_n)
        held = held_lengths_m(self.mechanism, command + self.parameters.joint_zeros_rad(theta))
        touched = replace(built, contact_m=places)
        rest = solve_equilibrium(touched, command, forces, held_m=held)
        levers = kinematics.contact_torques(built, rest.joint_angles_rad, axes)
        torque = np.zeros(len(command))
        for push in pushes:
            lever = levers[0][push.segment] + push.place_m * levers[1][push.segment]
            torque = torque + np.array(push.force_n) @ lever
        return rest, torque

    def read(self, theta, command, pushes=()):
        """Readings without noise."""
        rest, _ = self.rest(theta, command, pushes)
        return self.parameters.read(theta, rest.tensions_n)

    def answer(self, readings, commands, mean, covariance=None):
        """`EstimatorOutput` in NumPy, of one sample (without leading axis) or several."""
        count = len(self.parameters)
        covariance = np.zeros((count, count)) if covariance is None else covariance
        joints = self.mechanism.joint_count
        given = (
            np.atleast_2d(readings),
            np.atleast_2d(commands),
            mean,
            covariance,
            np.zeros((joints, joints)),
        )
        with torch.no_grad():
            output = self.estimator(*(torch.as_tensor(each) for each in given))
        several = np.ndim(readings) == 2
        return SimpleNamespace(
            **{
                name: value.numpy() if several else value[0].numpy()
                for name, value in output._asdict().items()
            }
        )


def inferred_torque(answer):
    """The torques (2N,) that readings show, by weighted least squares."""
    weighted = answer.by_torque.T @ answer.information_n2
    return np.linalg.solve(weighted @ answer.by_torque, weighted @ answer.innovation_n)
