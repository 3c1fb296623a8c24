"""The answer to one sample: contact, what is known of its force, why where nothing is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cablesense_msgs_py.messages import NO_CONTACT, UNKNOWN_WRENCH, Contact, ForceState
from cablesense_online.models import force_bounds
from cablesense_online.samples import SampleError
from cablesense_online.state import EstimatorState
from cablesense_online.tare import Tare
from cablesense_training.inference.estimator import Estimate


class Answer(NamedTuple):
    """The answer to one sample; by default that of none.

    Attributes:
        contact: `NO_CONTACT` also when the force is not known; of several the strongest.
        force: what is known of it.
        estimate: that it rests on; none where there is none, or where it is of several contacts.
        contact_m: (N,) where on its axis each segment is touched; empty without an estimate.
        probabilities: (N+1,) of no contact, segment 1, …; empty when nothing was estimated.
        stamp_ns: time of the sample; 0 when it has none, or cannot be trusted.
        problem: why the sample could not be used.
        new_tare: the tare that was taken by `auto_tare`; it counts from the next sample on.
        state: the state that answers rest on from this sample on, where that has changed.
        contacts: all that were estimated, the strongest first.
    """

    contact: Contact = NO_CONTACT
    force: ForceState = ForceState.SILENT
    estimate: Estimate | None = None
    contact_m: Sequence[float] = ()
    probabilities: Sequence[float] = ()
    stamp_ns: int = 0
    problem: SampleError | None = None
    new_tare: Tare | None = None
    state: EstimatorState | None = None
    contacts: Sequence[Contact] = ()

    @property
    def bounds(self) -> tuple[Contact, Contact] | None:
        """Ends of the 95 % intervals of force and direction; none without an estimate."""
        if self.estimate is None:
            return None
        return force_bounds(self.estimate, self.contact, self.contact_m)

    def on_segment(self, number: int, unknown_force: str) -> Sequence[float] | None:
        """As `wrench`, of segment `number` alone, from 1 on."""
        for contact in self.contacts:
            if contact.segment == number:
                return contact.wrench
        return NO_CONTACT.wrench if self.contacts else self.wrench(unknown_force)

    def wrench(self, unknown_force: str) -> Sequence[float] | None:
        """Force, N, and torque, N·m, to be published (6,); none where none is.

        A contact is, also an unconfirmed one; `unknown_force` as in `EstimationSettings`.
        """
        if self.contact.segment or self.force.known or unknown_force == "zero":
            return self.contact.wrench
        return UNKNOWN_WRENCH if unknown_force == "nan" else None
