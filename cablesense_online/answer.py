"""The answer to a sample: decision on a contact, its bounds, and the published wrench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

from cablesense_msgs_py.messages import NO_CONTACT, UNKNOWN_WRENCH, Contact, ForceState
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.state import EstimatorState, Tare
from cablesense_training.inference.estimator import NORMAL_95, Estimate

_HALF_TURN_DEG = 179.9
"""Half the widest interval of a direction: the ends of a whole turn could not be distinguished."""


@dataclass(slots=True)
class Answer:
    """The answer to one sample; by default that of none.

    Attributes:
        force: what is known of the force.
        contacts: all estimated contacts, the strongest first.
        estimate: the estimate behind a single contact, or none; None without an estimate.
        contact_m: (N,) where on its axis each segment is touched; empty without an estimate.
        probabilities: (N+1,) of no contact, segment 1, …; empty when nothing was estimated.
        stamp_ns: time of the sample; 0 when it has none, or it cannot be trusted.
        problem: why the sample could not be used.
        new_tare: the tare that was taken by `auto_tare`; it counts from the next sample on.
        state: the state that answers rest on from this sample on, if it has changed.
    """

    force: ForceState = ForceState.SILENT
    contacts: Sequence[Contact] = ()
    estimate: Estimate | None = None
    contact_m: Sequence[float] = ()
    probabilities: Sequence[float] = ()
    stamp_ns: int = 0
    problem: SampleError | None = None
    new_tare: Tare | None = None
    state: EstimatorState | None = None

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
        estimate, segment = self.estimate, self.contact.segment
        if estimate is None:
            return None
        low_n, high_n = estimate.low_n if segment else 0.0, estimate.high_n
        if not segment:
            segment = 1 + int(estimate.probabilities[1:].argmax())
        half_deg = min(NORMAL_95 * estimate.angle_std_deg, _HALF_TURN_DEG)
        low_m, high_m, moment_n_m = self.contact_m[segment - 1], self.contact_m[segment - 1], None
        if (place := estimate.place) is not None:
            low_m = high_m = place.place_m
            if self.contact.segment and not place.force_known:
                # a weak force acts far from the joint, a strong one near
                low_m, high_m, moment_n_m = place.high_m, place.low_m, place.moment_n_m
        low_deg, high_deg = estimate.angle_deg - half_deg, estimate.angle_deg + half_deg
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
    if not (isfinite(sum(probabilities)) and isfinite(angle_deg) and isfinite(magnitude_n)):
        raise SampleError(
            ProblemKind.ESTIMATE, "the model gave a number that is not finite for this sample"
        )
    if 1.0 - probabilities[0] < threshold or magnitude_n <= 0.0:
        return NO_CONTACT
    segment = max(range(1, len(probabilities)), key=probabilities.__getitem__)
    return Contact(segment, angle_deg, magnitude_n, contact_m[segment - 1])
