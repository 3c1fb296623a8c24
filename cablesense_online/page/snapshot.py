"""One instant of a machine as the page shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact, ForceState, Level

IN_CONTACT = (ForceState.CONTACT, ForceState.UNCONFIRMED, ForceState.MOMENT)
ANSWERED = (*IN_CONTACT, ForceState.FREE, ForceState.HIDDEN)
"""States in which the estimator stated something."""


class PlaceInterval(NamedTuple):
    """Ends, m along the axis of a link, of what an interval of places covers of it."""

    segment: int
    low_m: float
    high_m: float


class ForceBounds(NamedTuple):
    """Ends of the stated 95 % intervals of normal force and contact angle.

    The angle is between the two, from the first on with a growing angle; None where any may be.
    """

    low_n: float
    high_n: float
    angles_deg: tuple[float, float] | None = None


class CommissioningProgress(NamedTuple):
    """How many of a commissioning's holds are done."""

    done: int
    holds: int


@dataclass(frozen=True)
class ShownStatus:
    """The estimator's state: level, headline, and notes for a person."""

    level: Level
    headline: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Snapshot:
    """One instant of a machine; None is not known.

    Attributes:
        time_s: of the newest readings, any steady clock.
        pose: (T,) of its joints, measured or commanded.
        frame_pose: (T,) the one in whose axes contacts are: mostly the commanded.
        readings: (M,) of its sensors.
        true: contacts that the applied loads make, the strongest first.
        state: of the estimate.
        estimated: contacts, the strongest first; none when nothing touches and when the force is
            unknown.
        bounds: of the strongest estimated force, of the one behind `known_by_moment`, or of one
            that friction hides.
        probabilities: (N + 1,) of no contact and of each link.
        known_by_moment: a contact of which the moment alone is known.
        region: the 95 % interval of where the strongest contact, or the one behind
            `known_by_moment`, acts: what it covers of each link, in their order.
        machine_known: how well the estimator knows it, as a sentence; empty where it does not.
        commissioning: of one that is under way.
    """

    time_s: float
    pose: Array
    frame_pose: Array
    readings: Array | None
    true: tuple[Contact, ...]
    state: ForceState
    estimated: tuple[Contact, ...]
    bounds: ForceBounds | None
    probabilities: Array | None
    status: ShownStatus
    known_by_moment: Contact | None = None
    region: tuple[PlaceInterval, ...] = ()
    machine_known: str = ""
    commissioning: CommissioningProgress | None = None

    @property
    def answered(self) -> bool:
        """Whether the estimator gave a contact, or that none can be seen."""
        return self.state in ANSWERED
