"""The answer to a sample: decision on a contact, its bounds, and the published wrench.

`ContactStatics` gives contacts as a controller takes them: in base axes and at the joints.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_contact.estimate import NORMAL_95, Estimate
from cablesense_contact.felt import LinksAtPose
from cablesense_msgs_py.messages import NO_CONTACT, UNKNOWN_WRENCH, Contact, ForceState
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.tare import Tare
from cablesense_sim.rotations import quaternion_xyzw

_HALF_TURN_DEG = 179.9
"""Half the widest interval of a direction: the ends of a whole turn could not be distinguished."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to one sample; by default that of none.

    Attributes:
        force: what is stated of the force, or why nothing is.
        contacts: all estimated contacts, the strongest first.
        estimate: the estimate behind a single contact, or none; None without an estimate.
        contact_m: (N,) where on its axis each segment is touched; empty without an estimate.
        probabilities: (N+1,) of no contact, segment 1, …; empty when nothing was estimated.
        stamp_ns: time of the sample; 0 when it has none, or it cannot be trusted.
        problem: why the sample could not be used.
        new_tare: the tare that was taken by `auto_tare`; it counts from the next sample on.
        doubt: what else would explain the reading; empty without doubt.
        slack_cables: numbers, from 1, of the cables that are slack.
        pose_rad: (2N,) pose of the arm that the contacts are for; None without an estimate.
    """

    force: ForceState = ForceState.SILENT
    contacts: Sequence[Contact] = ()
    estimate: Estimate | None = None
    contact_m: Sequence[float] = ()
    probabilities: Sequence[float] = ()
    stamp_ns: int = 0
    problem: SampleError | None = None
    new_tare: Tare | None = None
    doubt: str = ""
    slack_cables: Sequence[int] = ()
    pose_rad: Array | None = None

    @property
    def contact(self) -> Contact:
        """The strongest contact; `NO_CONTACT` also when the force is not known."""
        return self.contacts[0] if self.contacts else NO_CONTACT

    @property
    def bounds(self) -> tuple[Contact, Contact] | None:
        """Ends of the 95 % intervals of force and direction; None without an estimate.

        Without a decided contact the lower end is none, and the upper is on the likeliest segment:
        this much may act unseen.
        """
        estimate = self.estimate
        segment = self.contact.segment
        if estimate is None:
            return None
        low_n = estimate.low_n if segment else 0.0
        high_n = estimate.high_n
        if not segment:
            segment = 1 + int(estimate.probabilities[1:].argmax())
        half_deg = min(NORMAL_95 * estimate.angle_std_deg, _HALF_TURN_DEG)
        low_m = self.contact_m[segment - 1]
        high_m = self.contact_m[segment - 1]
        moment_n_m = None
        if (place := estimate.place) is not None:
            low_m = place.place_m
            high_m = low_m
            if self.contact.segment and not place.force_known:
                # a weak force acts far from the joint, a strong one near
                low_m = place.high_m
                high_m = place.low_m
                moment_n_m = place.moment_n_m
        low_deg = estimate.angle_deg - half_deg
        high_deg = estimate.angle_deg + half_deg
        upper = Contact(segment, high_deg, high_n, high_m, moment_n_m=moment_n_m)
        if low_n <= 0.0:
            return NO_CONTACT, upper
        return Contact(segment, low_deg, low_n, low_m, moment_n_m=moment_n_m), upper

    @property
    def region_m(self) -> tuple[float, float] | None:
        """Between which a contact's place lies on its segment; None where it is not estimated."""
        estimate = self.estimate
        if not self.contact.segment or estimate is None or estimate.place is None:
            return None
        return estimate.place.low_m, estimate.place.high_m

    def on_segment(self, number: int, unknown_force: str) -> Sequence[float] | None:
        """The `wrench` on segment `number` alone, from 1 on."""
        for contact in self.contacts:
            if contact.segment == number:
                return contact.wrench
        return NO_CONTACT.wrench if self.contacts else self.wrench(unknown_force)

    def wrench(self, unknown_force: str) -> Sequence[float] | None:
        """Force, N, and torque, N·m, to be published (6,); None where none is.

        A contact is published even if unconfirmed; `unknown_force` as in `EstimationSettings`.
        """
        if self.contacts or self.force.known or unknown_force == "zero":
            return self.contact.wrench
        return UNKNOWN_WRENCH if unknown_force == "nan" else None


def decide(
    probabilities: Sequence[float],
    angle_deg: float,
    magnitude_n: float,
    threshold: float,
    contact_m: Sequence[float],
) -> Contact:
    """The likeliest segment, if a contact anywhere reaches the `threshold`; else `NO_CONTACT`.

    `probabilities` (N+1,) are of no contact, segment 1, …; a force that does not push is no
    contact; `contact_m` (N,) is where on its axis each segment is touched, from its joint on.

    Raises:
        SampleError: a number is not finite.
    """
    if not all(map(math.isfinite, (*probabilities, angle_deg, magnitude_n))):
        raise SampleError(
            ProblemKind.ESTIMATE, "the model gave a number that is not finite for this sample"
        )
    if 1.0 - probabilities[0] < threshold or magnitude_n <= 0.0:
        return NO_CONTACT
    segment = max(range(1, len(probabilities)), key=probabilities.__getitem__)
    return Contact(segment, angle_deg, magnitude_n, contact_m[segment - 1])


class ContactPose(NamedTuple):
    """Where a contact is in base axes, and how well that is known.

    Attributes:
        point_m: (3,) on the segment's axis.
        quaternion: (4,) x, y, z, w: its x axis points along the normal force, its z axis along the
            segment.
        covariance: (36,) by rows, of the point, m², and of turns about base axes, rad².
    """

    point_m: list[float]
    quaternion: list[float]
    covariance: list[float]


class ContactStatics:
    """Contacts at one pose of the machine, in base axes and at the joints.

    A contact on segment n with the force f and the moment m about the joint centre, in the
    segment's axes, makes the joint torques A_n' f + B_n' (m x e) with e the segment's x axis, A_n
    the torques of unit forces at the joint centre and B_n their slope by the place.
    """

    def __init__(self, links: LinksAtPose) -> None:
        self._axes = links.axes
        self._joints_m = links.origin_m
        self._by_force_m = links.by_force_m
        self._by_place = links.by_place

    def base_wrench(self, contacts: Sequence[Contact]) -> list[float]:
        """(6,) force, N, and moment about the base frame's origin, N·m, of all contacts."""
        wrench = np.zeros(6)
        for contact in contacts:
            n = contact.segment - 1
            force_n, moment_n_m = np.reshape(contact.wrench, (2, 3)) @ self._axes[n].T
            wrench[:3] += force_n
            wrench[3:] += moment_n_m + np.cross(self._joints_m[n], force_n)
        return wrench.tolist()

    def joint_torques_n_m(self, contacts: Sequence[Contact]) -> list[float]:
        """(T,) torques of all contacts at the joints."""
        torques = np.zeros(self._by_place.shape[2])
        for contact in contacts:
            n = contact.segment - 1
            (_, about_y, about_z) = contact.wrench[3:]
            torques += contact.wrench[:3] @ self._by_force_m[n]
            torques += np.array([0.0, about_z, -about_y]) @ self._by_place[n]
        return torques.tolist()

    def contact_pose(
        self, contact: Contact, place_std_m: float, angle_std_deg: float
    ) -> ContactPose:
        """The pose of a contact whose place and angle have these standard deviations.

        The place varies along the segment's axis, the direction about it.
        """
        n = contact.segment - 1
        (y, z) = contact.direction
        axes = self._axes[n]
        along = axes[:, 0]
        turn = axes @ np.array([[0.0, 0.0, 1.0], [y, -z, 0.0], [z, y, 0.0]])
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = np.outer(along, along) * place_std_m**2
        covariance[3:, 3:] = np.outer(along, along) * math.radians(angle_std_deg) ** 2
        return ContactPose(
            (self._joints_m[n] + contact.contact_m * along).tolist(),
            quaternion_xyzw(turn),
            covariance.ravel().tolist(),
        )
