"""One moment of the arm as the page shows it: contacts with their intervals, and the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from cablesense_base import Array
from cablesense_msgs_py.messages import ForceState, Level


@dataclass(frozen=True)
class ShownContact:
    """A force on the axis of a segment; true or estimated.

    Attributes:
        segment: 1 … N.
        angle_deg: of the normal part at the commanded pose, from the segment's +z towards its +y.
        magnitude_n: of the part normal to the segment, N.
        contact_m: where it acts, from the segment's joint centre, m.
        along_n: the part towards the segment's end, N; 0 where it is not estimated.
        force_base_n: (3,) the whole force in base axes.
    """

    segment: int
    angle_deg: float
    magnitude_n: float
    contact_m: float
    along_n: float
    force_base_n: Array


class KnownMoment(NamedTuple):
    """A contact of which only force times place is known.

    Attributes:
        segment: 1 … N.
        angle_deg: of the force, as in `ShownContact`.
        moment_n_m: about the segment's joint centre.
    """

    segment: int
    angle_deg: float
    moment_n_m: float


class PlaceInterval(NamedTuple):
    """Ends, m from the joint centre of a segment, of the 95 % interval of a contact's place."""

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


@dataclass(frozen=True)
class ShownStatus:
    """The estimator's state: level, headline, and notes for a person."""

    level: Level
    headline: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Snapshot:
    """One moment of the arm; None is not known.

    Attributes:
        time_s: of the newest tensions, any steady clock.
        joint_angles_rad: (2N,) measured or commanded.
        tensions_n: (M,).
        true: contacts that the applied loads make, the strongest first.
        state: of the estimate.
        estimated: contacts, the strongest first; none when nothing touches and when the force is
            unknown.
        bounds: of the strongest estimated force, or of the one behind `moment`.
        probabilities: (N + 1,) of no contact and of each segment.
        status: of the estimator.
        moment: of a contact of which only this is known.
        region: where the strongest contact, or the one behind `moment`, acts.
    """

    time_s: float
    joint_angles_rad: Array
    tensions_n: Array | None
    true: tuple[ShownContact, ...]
    state: ForceState
    estimated: tuple[ShownContact, ...]
    bounds: ForceBounds | None
    probabilities: Array | None
    status: ShownStatus
    moment: KnownMoment | None = None
    region: PlaceInterval | None = None

    @property
    def answered(self) -> bool:
        """Whether the estimator gave a contact, or that none can be seen."""
        return self.state in ANSWERED


IN_CONTACT = (ForceState.CONTACT, ForceState.UNCONFIRMED, ForceState.MOMENT)
ANSWERED = (*IN_CONTACT, ForceState.FREE, ForceState.HIDDEN)
_HEADLINES = {
    ForceState.FREE: "No contact",
    ForceState.CONTACT: "Contact",
    ForceState.MOMENT: "Contact",
    ForceState.UNCONFIRMED: "Unconfirmed contact",
    ForceState.HIDDEN: "No contact seen",
    ForceState.MOVING: "Moving: no estimate",
    ForceState.UNTARED: "No tare: no estimate",
    ForceState.REFUSED: "Readings refused: no estimate",
    ForceState.IMPLAUSIBLE: "Readings fit no contact: no estimate",
    ForceState.STALE: "Readings are out of date: no estimate",
    ForceState.SILENT: "The estimator is silent",
}


def headline(
    state: ForceState,
    estimated: tuple[ShownContact, ...],
    bounds: ForceBounds | None,
    moment: KnownMoment | None,
) -> str:
    """One sentence for the head of the page."""
    text = _HEADLINES[state]
    if moment is not None:
        text += f" on segment {moment.segment}: moment {moment.moment_n_m:.1f} N·m known"
        if bounds is not None:
            text += f", force between {bounds.low_n:.0f} and {bounds.high_n:.0f} N"
    elif estimated:
        numbers = " and ".join(str(n) for n in sorted(each.segment for each in estimated))
        text += f" on segment{'s' if len(estimated) > 1 else ''} {numbers}"
    if state is ForceState.HIDDEN and bounds is not None:
        text += f"; up to {bounds.high_n:.1f} N may act"
    return text
