"""What the estimator says to one sample of tensions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cablesense_msgs_py.contact import NO_CONTACT, Contact
from cablesense_msgs_py.journal import JournalEntry
from cablesense_ros.sample_error import SampleError
from cablesense_ros.tare import Tare


class Outcome(NamedTuple):
    """The answer to one sample.

    Attributes:
        contact: `NO_CONTACT` also when the sample was of no use.
        probabilities: (N+1,) of no contact, segment 1, …; empty when nothing was estimated.
        stamp_ns: time of the sample; 0 when it has none, or cannot be trusted.
        problem: why the sample was of no use.
        new_tare: the tare that was taken by itself; it counts from the next sample on.
        entry: what the answers rest on from this sample on, where that has changed.
    """

    contact: Contact = NO_CONTACT
    probabilities: Sequence[float] = ()
    stamp_ns: int = 0
    problem: SampleError | None = None
    new_tare: Tare | None = None
    entry: JournalEntry | None = None
