"""What a calibration is worth: how well it lets a contact be known, as the interval of its force.

A fixed set of contacts stands for all: on every segment, in some poses, of one size. Parameters of
the arm with covariance Σ disturb readings by G Σ Gᵀ, beside the sensors' noise R. A contact of
place s and force f changes readings by A (δs, δf). So its covariance is

    (Aᵀ (R + G Σ Gᵀ)⁻¹ A + P)⁻¹,

with the precision P of what is known of any contact: that it is on its segment, and that it does
not pull hard along the axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_contact.estimate import NORMAL_95
from cablesense_contact.law import Law
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.touch import touched_places

BEND_RAD = float(np.deg2rad(10.0))
"""Joint angles of the poses, at most."""
FORCE_N = 20.0
"""Of each contact by which arms are compared."""
_POSES = 6
"""Random poses in which every segment is touched."""
_AXIAL_STD_N = 10.0
"""Prior deviation of the axial force."""
_LATERAL_STD_N = 100.0
"""Prior deviation of each lateral component: five times `FORCE_N`, so that it says little."""
_SEED = 20
"""Of poses and directions: all arms and calibrations are compared on the same contacts."""


class ContactResponse(NamedTuple):
    """Readings of T contacts, linear about them.

    Attributes:
        by_contact: (T, M, 4) derivative by place, m, and force along the segment's axes, N.
        by_parameter: (T, M, P) derivative by the arm's parameters.
        information_n2: (T, M, M) inverse covariance of a reading.
    """

    by_contact: Array
    by_parameter: Array
    information_n2: Array


class ReferenceContacts:
    """Contacts of `FORCE_N` across every segment of an arm, in poses within a bend range.

    Attributes:
        prior_precision: (T, 4, 4) of place and force, before any reading.
    """

    def __init__(self, arm: Arm, bend_rad: float = BEND_RAD) -> None:
        """Find the rests of the arm of the file under these contacts.

        Raises:
            EquilibriumError: the arm does not bear such a contact.
        """
        count = arm.segment_count
        rng = np.random.default_rng(_SEED)
        nominal = mechanism_of(arm)
        mechanism = amended(nominal, entries_of(arm))
        poses = rng.uniform(-bend_rad, bend_rad, (_POSES, arm.joint_count))
        self._command_rad = np.repeat(poses, count, axis=0)
        segment = np.tile(np.arange(count), _POSES)
        rows = np.arange(len(segment))
        angle = rng.uniform(0.0, 2.0 * np.pi, len(segment))
        direction = np.stack([np.zeros_like(angle), np.sin(angle), np.cos(angle)], axis=1)
        axes = kinematics.segment_rotations(mechanism, self._command_rad)[rows, segment]
        forces_n = np.zeros((len(segment), count, 3))
        forces_n[rows, segment] = FORCE_N * (axes @ direction[:, :, None])[..., 0]
        held_m = held_lengths_m(nominal, self._command_rad)
        rest = solve_equilibrium(mechanism, self._command_rad, forces_n, held_m=held_m)
        self._reading_n = rest.tensions_n
        self._segment = segment
        self._direction = direction
        self._place_m = mechanism.contact_m[segment]
        reach_m = touched_places(arm).touched_m[segment]
        variances = np.empty((len(segment), 4))
        variances[:, 0] = (reach_m[:, 1] - reach_m[:, 0]) ** 2 / 12.0
        variances[:, 1] = _AXIAL_STD_N**2
        variances[:, 2:] = _LATERAL_STD_N**2
        self.prior_precision = np.eye(4) / variances[:, None]
        self._unrest = np.zeros((arm.joint_count, arm.joint_count))

    def response(self, law: Law, mean: Array, covariance: Array) -> ContactResponse:
        """How readings follow contacts and parameters, at mean (P,) and covariance (P, P)."""
        seen = law(self._reading_n, self._command_rad, mean, covariance, self._unrest)
        rows = np.arange(len(self._segment))
        by_place = seen.by_place[rows, self._segment]
        by_force = seen.at_joint_m[rows, self._segment] + self._place_m[:, None, None] * by_place
        moved = FORCE_N * (self._direction[:, None] @ by_place)
        by_contact = seen.by_torque @ np.concatenate([moved, by_force], axis=1).transpose(0, 2, 1)
        return ContactResponse(by_contact, seen.by_parameter, seen.information_n2)

    def force_known_n(self, law: Law, mean: Array, covariance: Array) -> float:
        """Half of the 95 % interval of a contact's size as one reading tells it: the median, N."""
        seen = self.response(law, mean, covariance)
        information = seen.by_contact.transpose(0, 2, 1) @ seen.information_n2 @ seen.by_contact
        spread = np.linalg.inv(information + self.prior_precision)[:, 1:, 1:]
        variance = np.einsum("ti,tij,tj->t", self._direction, spread, self._direction)
        return NORMAL_95 * float(np.median(np.sqrt(variance)))
