"""Where the parameters of a machine enter its forces, at a pose that is held fixed.

At a pose r with tensions T, with k the stiffness of taut tendons and zero of slack ones,

    δT = k δl + (T - T0) δln k + δT0 - T δc,
    δF = -Σ_k T_k δJ_k + δ(weights) + q_s δln k_s,

where δl and δJ follow from displaced sites and joint zeros, c is the logarithm of how much more a
tension stretches a tendon with friction (`tendon_friction`), whose pieces' tensions are in δJ too,
and q_s are the forces of springs in joints. What does not depend on T and on
the springs' own angles is taken once, near where the machine is: the sources.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_contact.machine.tendon_friction import Carried
from cablesense_sim.machine.built_machine import BuiltMachine
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.statics import Balance

_MOVED_M = 1e-6
"""By which a site is moved to see what follows from it."""


class Sensitivity(NamedTuple):
    """Derivatives by S sources at a fixed pose.

    Attributes:
        of_tensions: (K, S) of tendons that are held at their actuators.
        of_forces: (n, S) of the generalised forces at tensions that stay as they are.
    """

    of_tensions: Array
    of_forces: Array


class ParameterSources:
    """The S sources through which P parameters enter a machine with K tendons.

    In this order: lengths, logarithms of stiffness, pretensions and stretch by friction of the K
    tendons; their moments, n of each; the n weights; the logarithms of the springs' stiffness.

    Attributes:
        rows: (S, P) derivatives of the sources by the parameters.
    """

    def __init__(
        self,
        machine: Machine,
        parameters: MachineParameters,
        built: BuiltMachine,
        command: Array,
        pose: Array,
    ) -> None:
        """Of a built machine at a command (C,), with its geometry at a pose (n,)."""
        self._machine = machine
        self._parameters = parameters
        self._built = built
        tendons = len(machine.tendons.ids)
        count = len(pose)
        sizes = [tendons] * 4 + [tendons * count, count, len(parameters.springs)]
        self._parts = list(_successive(sizes))
        lengths, stiffness, pretension, _, moments, weights, springs = self._parts
        slices = parameters.slices
        self.rows = np.zeros((sum(sizes), len(parameters)))
        balance = built.statics.at(pose)
        moment = np.zeros((tendons, count, len(parameters)))

        self.rows[stiffness, slices["tendon_stiffness"]] = np.eye(tendons)
        self.rows[pretension, slices["pretension"]] = np.eye(tendons)
        self.rows[springs, slices["joint_stiffness"]] = np.eye(len(parameters.springs))
        self.rows[springs, slices["common_joint_stiffness"]] = 1.0
        if machine.source.file.joints == "commanded":
            held = built.statics.at(command).moment
            zeros = np.concatenate(
                [np.arange(len(parameters))[slices[name]] for name in ("joint_zero", "slide_zero")]
            )
            is_hinge = machine.coordinates.is_hinge
            order = np.concatenate([np.flatnonzero(is_hinge), np.flatnonzero(~is_hinge)])
            self.rows[lengths, zeros] = -held[:, order]

        built.statics.at(pose)
        by_mass, by_centre, by_gravity = built.statics.by_masses(parameters.bodies)
        masses_kg = machine.model.body_mass[parameters.bodies]
        by_places = by_centre.transpose(1, 0, 2).reshape(-1, count)
        tilts = np.cross(np.eye(3)[:2], machine.model.opt.gravity)
        self.rows[weights, slices["mass"]] = (masses_kg[:, None] * by_mass).T
        self.rows[weights, slices["centre_of_mass"]] = by_places.T
        self.rows[weights, slices["base_tilt"]] = (tilts @ by_gravity).T

        routed = _by_routing(machine, parameters, built, pose, balance)
        self.rows[lengths, slices["routing"]] = routed.length
        moment[:, :, slices["routing"]] = routed.moment
        self.rows[moments] = moment.reshape(tendons * count, len(parameters))

    def rubbing(self, built: BuiltMachine, friction: Carried) -> ParameterSources:
        """The sources of the same machine with friction, which is small beside its geometry."""
        rubbing = copy.copy(self)
        rubbing._built = built
        rubbing.rows = self.rows.copy()
        *_, carried, moments, _, _ = self._parts
        numbers = np.arange(len(self._parameters))[self._parameters.carried_friction]
        guides, tendons, count = friction.moment_by_carried_m.shape
        tendon = np.tile(np.arange(tendons), guides)
        rubbing.rows[carried.start + tendon, numbers] = friction.stretch_by_carried.ravel()
        by_parameter = rubbing.rows[moments].reshape(-1, count, len(self._parameters))
        by_carried = friction.moment_by_carried_m.reshape(guides * tendons, count)
        by_parameter[tendon, :, numbers] = by_carried
        return rubbing

    def entering(self, tensions_n: Array, pose: Array) -> Sensitivity:
        """How the sources enter at tensions (K,) and a pose (n,)."""
        lengths, stiffness, pretension, carried, moments, weights, springs = self._parts
        built = self._built
        tendons = len(tensions_n)
        count = len(pose)
        taut = (tensions_n > 0.0).astype(float)
        of_tensions = np.zeros((tendons, len(self.rows)))
        of_forces = np.zeros((count, len(self.rows)))
        tendon_numbers = np.arange(tendons)
        of_tensions[tendon_numbers, tendon_numbers + lengths.start] = (
            built.statics.stiffness_n_m * taut
        )
        # T = k (l - held) + T0: the tension itself, but for what was set by hand
        of_tensions[tendon_numbers, tendon_numbers + stiffness.start] = (
            tensions_n - built.pretension_n / built.stretch * taut
        )
        of_tensions[tendon_numbers, tendon_numbers + pretension.start] = taut / built.stretch
        of_tensions[tendon_numbers, tendon_numbers + carried.start] = -tensions_n
        # F = ... - Σ_k T_k J_k: each moment enters one force
        coordinates = np.arange(count)
        of_moments = moments.start + count * tendon_numbers[:, None] + coordinates
        of_forces[coordinates, of_moments] = -tensions_n[:, None]
        of_forces[:, weights] = np.eye(count)
        of_forces[:, springs] = self._by_springs(pose)
        return Sensitivity(of_tensions, of_forces)

    def _by_springs(self, pose: Array) -> Array:
        """(n, J) forces of the springs in joints."""
        model = self._machine.model
        springs = self._parameters.springs
        coordinates = self._machine.coordinates
        qpos = coordinates.positions(pose)
        slope = coordinates.slope(qpos)
        away = qpos[springs] - model.qpos_spring[springs]
        force = -self._built.statics.model.jnt_stiffness[springs] * away
        return np.asarray(force * slope[springs].T)


def _successive(sizes: list[int]) -> Iterator[slice]:
    """Slices of these sizes, one after the other."""
    begin = 0
    for size in sizes:
        yield slice(begin, begin + size)
        begin += size


class _ByRouting(NamedTuple):
    """Derivatives by the 2S displacements of sites.

    Attributes:
        length: (K, 2S) of lengths, beyond those in the reference pose.
        moment: (K, n, 2S) of the tendons' moments.
    """

    length: Array
    moment: Array


def _by_routing(
    machine: Machine,
    parameters: MachineParameters,
    built: BuiltMachine,
    pose: Array,
    balance: Balance,
) -> _ByRouting:
    """By moving sites, as many at once as there are on different tendons."""
    routing = parameters.routing
    tendons, count = balance.moment.shape
    site_count = len(routing.ids)
    length = np.zeros((tendons, 2, site_count))
    moment = np.zeros((tendons, count, 2, site_count))
    statics = built.statics
    site_pos = statics.model.site_pos
    at_reference_m = statics.at(machine.reference).length_m
    for members in routing.rounds:
        ids = routing.ids[members]
        nominal = site_pos[ids].copy()
        passes = routing.tendon_of[members]
        tendon, member = np.nonzero(passes.T)
        sites = members[member]
        for way in range(2):
            site_pos[ids] = nominal + _MOVED_M * routing.across[members, way]
            moved = statics.at(pose)
            moved_reference_m = statics.at(machine.reference).length_m
            longer = moved.length_m - balance.length_m - (moved_reference_m - at_reference_m)
            turned = moved.moment - balance.moment
            length[tendon, way, sites] = longer[tendon] / _MOVED_M
            moment[tendon, :, way, sites] = turned[tendon] / _MOVED_M
        site_pos[ids] = nominal
    flat = 2 * site_count
    return _ByRouting(length.reshape(tendons, flat), moment.reshape(tendons, count, flat))
