"""One moment of a machine as the page shows it, the errors over many, and the colours.

Colours are safe for colour-blind eyes and readable on a dark ground. Tensions use the viridis map
without its darkest tenth; the two forces and the segments use the palette of Okabe and Ito
(*Color Universal Design*, 2008).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact, ForceState, Level


@dataclass(frozen=True)
class Words:
    """What a machine and its links are called.

    Attributes:
        machine: `arm` or `machine`.
        link: `segment` or `link`.
        links: (N,) of each: its number, or its name.
    """

    machine: str
    link: str
    links: tuple[str, ...]

    def of_link(self, number: int) -> str:
        """`segment 3`, or the name of the link alone; `number` counts from 1."""
        label = self.links[number - 1]
        return f"{self.link} {label}" if label.isdecimal() else label


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
    """One moment of a machine; None is not known.

    Attributes:
        time_s: of the newest readings, any steady clock.
        pose: (T,) of its joints, measured or commanded.
        frame_pose: (T,) the one in whose axes contacts are: mostly the commanded.
        readings: (M,) of its sensors.
        true: contacts that the applied loads make, the strongest first.
        state: of the estimate.
        estimated: contacts, the strongest first; none when nothing touches and when the force is
            unknown.
        bounds: of the strongest estimated force, of the one behind `moment`, or of one that
            friction hides.
        probabilities: (N + 1,) of no contact and of each link.
        moment: a contact of which only that is known.
        region: the 95 % interval of where the strongest contact, or the one behind `moment`, acts:
            what it covers of each link, in their order.
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
    moment: Contact | None = None
    region: tuple[PlaceInterval, ...] = ()
    machine_known: str = ""
    commissioning: CommissioningProgress | None = None

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
    ForceState.UNTARED: "Not tared: no estimate",
    ForceState.REFUSED: "Readings refused: no estimate",
    ForceState.IMPLAUSIBLE: "Readings fit no contact: no estimate",
    ForceState.STALE: "Readings are out of date: no estimate",
    ForceState.SILENT: "The estimator is silent",
}


def headline(
    state: ForceState,
    estimated: tuple[Contact, ...],
    bounds: ForceBounds | None,
    moment: Contact | None,
    words: Words,
) -> str:
    """One sentence for the head of the page."""
    text = _HEADLINES[state]
    if moment is not None:
        text += f" on {words.of_link(moment.segment)}: moment {moment.moment_n_m:.1f} N·m known"
        if bounds is not None:
            text += f", force between {bounds.low_n:.0f} and {bounds.high_n:.0f} N"
    elif len(estimated) == 1:
        text += f" on {words.of_link(estimated[0].segment)}"
    elif estimated:
        numbers = sorted(contact.segment for contact in estimated)
        labels = " and ".join(words.links[number - 1] for number in numbers)
        text += f" on {words.link}s {labels}"
    if state is ForceState.HIDDEN and bounds is not None:
        text += f"; up to {bounds.high_n:.1f} N may act"
    return text


SETTLING_S = 1.0
"""A comparison waits this long after a change: the arm swings and the estimate follows."""
_STILL_N = 0.01
"""Change of a load below which it stands still."""
_STILL_M = 0.001
"""Change of its place below which it stands still."""
_STILL_RAD = 0.003
"""Change of a joint angle below which the pose stands still."""
GUESS_DEG = 90.0
"""Direction error of a contact that was missed, or found on another segment: a guess's mean."""


def angle_error_deg(a_deg: float, b_deg: float) -> float:
    """The smaller turn between two angles, 0 … 180 degrees."""
    return abs((a_deg - b_deg + 180.0) % 360.0 - 180.0)


class Errors(NamedTuple):
    """Mean errors over the moments at rest with an answer; None before the first.

    Attributes:
        pushed: number of moments in which something pushed.
        untouched: number of moments in which nothing did.
        unanswered: share, 0 … 1, of the moments at rest in which the estimator gave no answer.
        segment_right: share, 0 … 1, of the pushed moments with the right segments.
        false_contacts: share, 0 … 1, of the untouched moments with a contact.
        place_mae_m: over contacts on the right segment whose place is estimated.
        angle_mae_deg: over contacts; `GUESS_DEG` for a miss.
        magnitude_mae_n: over contacts, true or estimated, but those of which the moment alone is
            known. The error of a contact on a wrong segment is the greater of the true and the
            estimated force.
    """

    pushed: int
    untouched: int
    unanswered: float | None
    segment_right: float | None
    false_contacts: float | None
    place_mae_m: float | None
    angle_mae_deg: float | None
    magnitude_mae_n: float | None


class Score:
    """Adds up errors while load and pose stay put."""

    def __init__(self, link_count: int, settling_s: float = SETTLING_S) -> None:
        self._link_count = link_count
        self._settling_s = settling_s
        self._still: Array | None = None
        self._still_since_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Discards every comparison."""
        self._pushed = 0
        self._untouched = 0
        self._right = 0
        self._false = 0
        self._unanswered = 0
        # number and sum of errors
        self._aside = np.zeros(2)
        self._turned = np.zeros(2)
        self._off = np.zeros(2)

    def add(self, snapshot: Snapshot) -> None:
        """Takes one moment, which counts if load and pose have stood still."""
        self._watch(snapshot)
        if snapshot.time_s - self._still_since_s < self._settling_s:
            return
        if snapshot.readings is None or snapshot.state is ForceState.MOVING:
            return
        if not snapshot.state.known and not snapshot.estimated:
            self._unanswered += 1
            return
        true = {contact.segment: contact for contact in snapshot.true}
        estimated = {contact.segment: contact for contact in snapshot.estimated}
        matched = true.keys() & estimated.keys()
        angles_deg = [(true[n].angle_deg, estimated[n].angle_deg) for n in matched]
        seen = set(estimated)
        moment = snapshot.moment
        if moment is not None:
            seen.add(moment.segment)
        if true:
            self._pushed += 1
            self._right += true.keys() == seen
        else:
            self._untouched += 1
            self._false += bool(seen)
        if moment is not None and moment.segment in true:  # no place and no force to compare
            angles_deg.append((true.pop(moment.segment).angle_deg, moment.angle_deg))
        missed_n = [true[n].magnitude_n for n in true.keys() - matched]
        ghosts_n = [estimated[n].magnitude_n for n in estimated.keys() - matched]
        aside_m = [abs(true[n].contact_m - estimated[n].contact_m) for n in matched]
        turned_deg = [angle_error_deg(*pair) for pair in angles_deg]
        turned_deg += [GUESS_DEG] * len(missed_n)
        off_n = [abs(true[n].magnitude_n - estimated[n].magnitude_n) for n in matched]
        off_n += map(max, zip_longest(missed_n, ghosts_n, fillvalue=0.0))
        self._aside += len(aside_m), sum(aside_m)
        self._turned += len(turned_deg), sum(turned_deg)
        self._off += len(off_n), sum(off_n)

    def _watch(self, snapshot: Snapshot) -> None:
        """Notes since when load and pose have stood still."""
        loads = np.zeros((self._link_count, 4))
        for contact in snapshot.true:
            force = np.array(contact.wrench[:3]) / _STILL_N
            loads[contact.segment - 1] = *force, contact.contact_m / _STILL_M
        now = np.append(loads, snapshot.pose / _STILL_RAD)
        if self._still is None or np.abs(now - self._still).max() >= 1.0:
            self._still = now
            self._still_since_s = snapshot.time_s

    @property
    def errors(self) -> Errors:
        """The errors up to now."""

        def mean(count: float, total: float) -> float | None:
            return total / count if count else None

        at_rest = self._pushed + self._untouched + self._unanswered
        return Errors(
            self._pushed,
            self._untouched,
            mean(at_rest, self._unanswered),
            mean(self._pushed, self._right),
            mean(self._untouched, self._false),
            mean(*self._aside),
            mean(*self._turned),
            mean(*self._off),
        )


Rgb = tuple[int, int, int]

TRUE_RGB: Rgb = (230, 159, 0)
"""Colour of true forces; these are colours that colour-blind people tell apart (Okabe and Ito)."""
ESTIMATE_RGB: Rgb = (86, 180, 233)
"""Colour of estimated forces."""
_UNREAD_RGB: Rgb = (150, 150, 158)
"""Colour of a cable that nothing reads."""
_SEGMENT_RGB: tuple[Rgb, ...] = ((86, 180, 233), (0, 178, 128), (240, 228, 66), (224, 140, 190))
"""Colours of segments in charts, in turn."""

TENSION_CSS = (
    *("#482475", "#414487", "#355f8d", "#2a788e", "#21918c"),
    *("#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725"),
)
"""Colours of tensions from slack to full scale, at equal steps."""
_TENSION_STOPS = np.array([list(bytes.fromhex(stop[1:])) for stop in TENSION_CSS], dtype=float)


def tension_rgb(tensions_n: ArrayLike, full_scale_n: float) -> NDArray[np.uint8]:
    """Colours (..., 3) of tensions: violet at 0 N (slack), yellow from `full_scale_n` on."""
    share = np.nan_to_num(np.asarray(tensions_n, dtype=float)) / full_scale_n
    stop_shares = np.linspace(0.0, 1.0, len(_TENSION_STOPS))
    rgb = [np.interp(share, stop_shares, channel) for channel in _TENSION_STOPS.T]
    return np.rint(np.stack(rgb, axis=-1)).astype(np.uint8)


def piece_rgb(
    readings: Array, piece_channel: NDArray[np.int64], full_scale_n: float
) -> NDArray[np.uint8]:
    """Colours (P, 3) of the pieces of cables, by the readings (M,) of their channels.

    `piece_channel` is (P,), -1 for pieces that nothing reads.
    """
    rgb = tension_rgb(readings[np.maximum(piece_channel, 0)], full_scale_n)
    rgb[piece_channel < 0] = _UNREAD_RGB
    return rgb


def linear_rgb(srgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colours for vertices, which the browser's renderer takes as linear light (IEC 61966-2-1)."""
    share = np.asarray(srgb, dtype=float) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.rint(255.0 * linear).astype(np.uint8)


def full_scale_n(peak_n: float, least_n: float) -> float:
    """The round tension that covers a peak, and at least so much: a scale that seldom changes."""
    most_n = max(peak_n, least_n)
    power = 10.0 ** math.floor(math.log10(most_n))
    steps_n = [step * power for step in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.5, 10.0)]
    return next(step_n for step_n in steps_n if step_n >= most_n)


def segment_rgb(segment: int) -> Rgb:
    """The colour of a segment's traces and bars; `segment` counts from 1."""
    return _SEGMENT_RGB[(segment - 1) % len(_SEGMENT_RGB)]


def css(rgb: Rgb) -> str:
    """A colour as `#rrggbb`."""
    return f"#{bytes(rgb).hex()}"
