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
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.estimate import NORMAL_95
from cablesense_contact.law import Law, no_unrest
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.touch import touched_places

BEND_RAD = float(np.deg2rad(10.0))
"""Joint angles of the poses, at most."""
_ARM_FORCE_N = 20.0
"""Of each contact by which arms are compared."""
_POSES = 6
"""Random poses in which every segment is touched."""
_AXIAL_STD = 0.5
"""Prior deviation of the axial force, over the contact's force."""
_LATERAL_STD = 5.0
"""The same of each lateral component: so large that it says little."""
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


class ReferenceLoads(NamedTuple):
    """T contacts of one force, and what is read of the machine that bears them.

    Attributes:
        force_n: of each.
        reading: (T, M) without noise.
        command: (T, C).
        link: (T,) numbers of the links, from 0 on.
        place_m: (T,) along them.
        direction: (T, 3) of the forces, in the links' axes.
        touched_m: (T, 2) where such a link is touched.
    """

    force_n: float
    reading: Array
    command: Array
    link: NDArray[np.int64]
    place_m: Array
    direction: Array
    touched_m: Array


class KnownForce(NamedTuple):
    """How well one reading tells the force of a contact.

    Attributes:
        push_n: the force.
        half_interval_n: half of its 95 % interval, the median of many such contacts.
    """

    push_n: float
    half_interval_n: float

    @property
    def text(self) -> str:
        """As a part of a sentence."""
        return f"a push of {self.push_n:g} N is known to ± {self.half_interval_n:.2g} N"


class ReferenceContacts:
    """Contacts of one force across every link of a machine, in several poses.

    Attributes:
        prior_precision: (T, 4, 4) of place and force, before any reading.
    """

    def __init__(self, contacts: ReferenceLoads, torque_count: int) -> None:
        """`torque_count` is T, of the machine that bears the contacts."""
        self._loads = contacts
        touched_m = contacts.touched_m
        variances = np.empty((len(touched_m), 4))
        variances[:, 0] = (touched_m[:, 1] - touched_m[:, 0]) ** 2 / 12.0
        variances[:, 1] = (_AXIAL_STD * contacts.force_n) ** 2
        variances[:, 2:] = (_LATERAL_STD * contacts.force_n) ** 2
        self.prior_precision = np.eye(4) / variances[:, None]
        self._unrest = no_unrest(torque_count)

    @classmethod
    def of_arm(cls, arm: Arm, bend_rad: float = BEND_RAD) -> ReferenceContacts:
        """The contacts of the arm of a file.

        Raises:
            EquilibriumError: the arm does not bear such a contact.
        """
        count = arm.segment_count
        rng = np.random.default_rng(_SEED)
        nominal = mechanism_of(arm)
        mechanism = amended(nominal, entries_of(arm))
        poses = rng.uniform(-bend_rad, bend_rad, (_POSES, arm.joint_count))
        command_rad = np.repeat(poses, count, axis=0)
        segment = np.tile(np.arange(count), _POSES)
        rows = np.arange(len(segment))
        angle = rng.uniform(0.0, 2.0 * np.pi, len(segment))
        direction = np.stack([np.zeros_like(angle), np.sin(angle), np.cos(angle)], axis=1)
        axes = kinematics.segment_rotations(mechanism, command_rad)[rows, segment]
        forces_n = np.zeros((len(segment), count, 3))
        forces_n[rows, segment] = _ARM_FORCE_N * (axes @ direction[:, :, None])[..., 0]
        held_m = held_lengths_m(nominal, command_rad)
        rest = solve_equilibrium(mechanism, command_rad, forces_n, held_m=held_m)
        loads = ReferenceLoads(
            force_n=_ARM_FORCE_N,
            reading=rest.tensions_n,
            command=command_rad,
            link=segment,
            place_m=mechanism.contact_m[segment],
            direction=direction,
            touched_m=touched_places(arm).touched_m[segment],
        )
        return cls(loads, arm.joint_count)

    def response(self, law: Law, mean: Array, covariance: Array) -> ContactResponse:
        """How readings follow contacts and parameters, at mean (P,) and covariance (P, P)."""
        loads = self._loads
        seen = law(loads.reading, loads.command, mean, covariance, self._unrest)
        rows = np.arange(len(loads.link))
        by_place = seen.by_place[rows, loads.link]
        by_force = seen.at_joint_m[rows, loads.link] + loads.place_m[:, None, None] * by_place
        moved = loads.force_n * (loads.direction[:, None] @ by_place)
        by_contact = seen.by_torque @ np.concatenate([moved, by_force], axis=1).transpose(0, 2, 1)
        return ContactResponse(by_contact, seen.by_parameter, seen.information_n2)

    def known_force(self, law: Law, mean: Array, covariance: Array) -> KnownForce:
        """How well one reading tells a contact's force, at mean (P,) and covariance (P, P)."""
        seen = self.response(law, mean, covariance)
        information = seen.by_contact.transpose(0, 2, 1) @ seen.information_n2 @ seen.by_contact
        spread = np.linalg.inv(information + self.prior_precision)[:, 1:, 1:]
        direction = self._loads.direction
        variance = np.einsum("ti,tij,tj->t", direction, spread, direction)
        half_interval_n = NORMAL_95 * float(np.median(np.sqrt(variance)))
        return KnownForce(self._loads.force_n, half_interval_n)
