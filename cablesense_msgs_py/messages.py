"""Values to and from ROS messages: named arrays, breaths, contacts, loads, health.

Nothing here needs ROS. In a `sensor_msgs/JointState`, tensions are the efforts and joint angles
the positions.
"""

from __future__ import annotations

import array
import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import Any, NamedTuple

import numpy as np

from cablesense_base import Array, some_of
from cablesense_msgs_py.topics import ContractError, Frames

MAX_JOINT_ANGLE_RAD = math.radians(60.0)
"""Commands beyond this are refused: no universal joint between guide plates reaches it."""
MAX_CABLE_OFFSET_M = 0.005
"""A larger offset of a cable is a wrong unit: it pulls a soft arm's cables with hundreds of N."""
MAX_LOAD_N = 2_000.0
"""A larger force is a wrong unit or a slip, not a push."""


class NamedOrder:
    """Arranges named values in the order of `names`, whatever order they come in."""

    def __init__(self, names: Sequence[str], what: str, *, among_others: bool = False) -> None:
        """`names` is the order wanted; `what` ("cables") is their kind, for errors.

        `among_others` is whether a message may have other names, too.
        """
        self.names = tuple(names)
        self._what = what
        self._among_others = among_others

    def arrange(self, names: Sequence[str], values: Sequence[float], field: str) -> Array:
        """What `pick` gives, as an array."""
        return np.array(self.pick(names, values, field), dtype=np.float64)

    def pick(self, names: Sequence[str], values: Sequence[float], field: str) -> tuple[float, ...]:
        """The values, one per name of a message, in the order wanted; `field` is for errors.

        Raises:
            ContractError: a name is missing, unknown or repeated, or there is not one value per
                name.
        """
        given_names = tuple(names)
        if given_names != self.names:
            self._require_same(given_names)
        if len(values) != len(given_names):
            raise ContractError(
                f"{field} holds {len(values)} values for {len(given_names)} names; "
                f"it must hold one per name ({len(self.names)})"
            )
        if given_names == self.names:
            return tuple(values)
        by_name = dict(zip(given_names, values, strict=True))
        return tuple(by_name[name] for name in self.names)

    def _require_same(self, given: tuple[str, ...]) -> None:
        counts = Counter(given)
        wrong = {
            "missing": [name for name in self.names if name not in counts],
            "unknown": [
                name for name in counts if name not in self.names and not self._among_others
            ],
            "more than once": [name for name, count in counts.items() if count > 1],
        }
        problems = "; ".join(
            f"{kind} {some_of([repr(name[:40]) for name in names])}"
            for kind, names in wrong.items()
            if names
        )
        if problems:
            raise ContractError(
                f"name: {problems}; the {len(self.names)} {self._what} of this arm are "
                f"{self.names[0]} … {self.names[-1]}, in any order, each once"
            )


def put_tensions(message: Any, tensions_n: Array) -> None:
    """Put (M,) tensions in N into a `JointState` whose names are set already."""
    message.effort = array.array("d", tensions_n.tolist())


def put_joint_angles(message: Any, angles_rad: Array) -> None:
    """Put (2N,) joint angles in rad into a `JointState` whose names are set already."""
    message.position = array.array("d", angles_rad.tolist())


def joint_command_rad(
    message: Any,
    order: NamedOrder,
    present_rad: Array | None = None,
    largest: float = MAX_JOINT_ANGLE_RAD,
) -> Array:
    """The (2N,) joint angles that a `JointState` commands, in the arm's order.

    It may name other machines' joints, and some of this arm's: the others keep their `present_rad`
    (2N,), straight where there is none. No position is beyond ± `largest`.

    Raises:
        ContractError: none of the arm's joints is named, or one repeatedly, or an angle is not
            finite or out of reach.
    """
    names = message.name
    angles = message.position
    if len(angles) != len(names):
        raise ContractError(f"position holds {len(angles)} values for {len(names)} names")
    named = [pair for pair in zip(names, angles, strict=True) if pair[0] in order.names]
    angle_by_name = dict(named)
    if not angle_by_name or len(angle_by_name) < len(named):
        order.pick(names, angles, "position")  # says what is wrong
    before = np.zeros(len(order.names)) if present_rad is None else present_rad
    command = np.array([angle_by_name.get(n, b) for n, b in zip(order.names, before, strict=True)])
    unit = "rad (a third of pi)" if largest == MAX_JOINT_ANGLE_RAD else "rad or m"
    _require_within(order, command, largest, unit)
    return command


def cable_offsets_m(message: Any, order: NamedOrder) -> Array:
    """The (M,) lengths that a `JointState` adds to the cables' commanded ones, in the arm's order.

    Raises:
        ContractError: a cable is missing, unknown or repeated, or a length is not finite or too
            large.
    """
    offsets = order.arrange(message.name, message.position, "position")
    _require_within(order, offsets, MAX_CABLE_OFFSET_M, "m")
    return offsets


def _require_within(order: NamedOrder, positions: Array, limit: float, unit: str) -> None:
    for name, position in zip(order.names, positions, strict=True):
        if not abs(position) <= limit:
            raise ContractError(
                f"position of {name} is {position:g} {unit.split()[0]}; it must be finite and "
                f"within ±{limit:.3f} {unit}"
            )


BREATH_END = -1
"""Instead of a turn: the breath is over, and the arm back where it was commanded before."""


def breath_turn(message: Any) -> int | None:
    """The turn of a breath that a command or offset belongs to; none of one that does not.

    `header.frame_id` is `breath N` in the N-th whole turn, from 1 on, `breath 0` on the way there
    and back, `breath end` in the last message of a breath.

    Raises:
        ContractError: none of these.
    """
    frame = str(message.header.frame_id)
    if not frame.startswith("breath"):
        return None
    match = re.fullmatch(r"breath (end|[0-9]{1,9})", frame)
    if match is None:
        raise ContractError(
            f"header.frame_id is {frame[:40]!r}; of a breath it is 'breath 0', 'breath' and the "
            "number of a whole turn, or 'breath end'"
        )
    return BREATH_END if match.group(1) == "end" else int(match.group(1))


def breath_frame(turn: int) -> str:
    """The `header.frame_id` that `breath_turn` reads."""
    return "breath end" if turn == BREATH_END else f"breath {turn}"


class Contact(NamedTuple):
    """A push of the environment on the arm, or none.

    Attributes:
        segment: the touched segment, counted from 1; 0 when nothing touches.
        angle_deg: direction of the force in the plane normal to the segment at the commanded joint
            angles, from +z towards +y of that segment's frame.
        magnitude_n: of the force normal to the segment, N.
        contact_m: distance of the contact point from the segment's joint centre, along its axis.
        along_n: force along the segment, towards its end, N; 0 where it is not known.
        moment_n_m: of the force about the joint centre; None means that at `contact_m`. With
            a `magnitude_n` of 0 it is all that is known of the contact, next to the direction.
    """

    segment: int = 0
    angle_deg: float = 0.0
    magnitude_n: float = 0.0
    contact_m: float = 0.0
    along_n: float = 0.0
    moment_n_m: float | None = None

    @classmethod
    def of_force(
        cls, segment: int, force_n: Sequence[float], contact_m: float, *, known: bool = True
    ) -> Contact:
        """Of a force (3,) in the segment's frame at a place; where not `known`, of its moment."""
        along_n, y, z = force_n
        size_n = math.hypot(y, z)
        moment_n_m = None
        if not known:
            size_n, moment_n_m = 0.0, contact_m * size_n
        angle_deg = math.degrees(math.atan2(y, z)) % 360.0
        return cls(segment, angle_deg, size_n, contact_m, along_n, moment_n_m)

    @property
    def direction(self) -> tuple[float, float]:
        """(y, z) of the lateral force's unit vector in the segment's frame."""
        angle = math.radians(self.angle_deg)
        return math.sin(angle), math.cos(angle)

    @property
    def wrench(self) -> tuple[float, float, float, float, float, float]:
        """The force, N, and its moment about the origin of the segment's frame, N·m."""
        y, z = self.direction
        size = self.magnitude_n
        moment = self.moment_n_m
        if moment is None:
            moment = self.contact_m * size
        return self.along_n, size * y, size * z, 0.0, -moment * z, moment * y


NO_CONTACT = Contact()
UNKNOWN_WRENCH = (math.nan,) * 6
"""Published in place of an unknown force, if the settings ask for not a number."""


@dataclass(frozen=True)
class Load:
    """A force (3,) on the axis of a segment, counted from 1; in base axes.

    It acts at `contact_m` from the segment's joint centre, None is the contact point of the arm
    file.
    """

    segment: int
    force_base_n: Array
    contact_m: float | None = None


ContactOf = Callable[[Array, Array], tuple[int, float]]
"""The segment and the place on its axis where a force (3,) with a torque (3,) acts, base frame."""
PlaceOf = Callable[[int, Array, Array], float]
"""The place on the axis of a link, from 1, where a force (3,) acts: by its torque (3,) about the
origin of the link's message frame; both in base axes."""


def read_load(
    message: Any,
    frames: Frames,
    contact_of: ContactOf | None = None,
    place_of: PlaceOf | None = None,
) -> Load:
    """The load that a `WrenchStamped` describes.

    In the base frame it is a wrench as tf2 understands one, whose torque about the frame's origin
    states where the force acts; `contact_of` reads that at the present pose. In the frame of a
    segment the force acts at its contact point, in base axes all the same; or, where there is a
    `place_of`, where its torque says.

    Raises:
        CableSenseError: an unknown frame, a force that is not finite or too large, a torque in the
            frame of a segment without a `place_of`; or of `contact_of` and `place_of`.
    """
    force, torque = (
        np.array([vector.x, vector.y, vector.z], dtype=np.float64)
        for vector in (message.wrench.force, message.wrench.torque)
    )
    if not np.linalg.norm(force) <= MAX_LOAD_N:
        raise ContractError(
            f"wrench.force is {_shown(force)} N; it must be finite, at most {MAX_LOAD_N:g} N"
        )
    if contact_of is not None and message.header.frame_id == frames.base:
        if not force.any():
            raise ContractError(
                "wrench.force is zero in the base frame; a zero force in a segment's frame "
                "releases it"
            )
        segment, contact_m = contact_of(force, torque)
        return Load(segment, force, contact_m)
    segment = frames.segment_number(message.header.frame_id)
    if not torque.any():
        return Load(segment, force)
    if place_of is None:
        raise ContractError(
            f"wrench.torque is {_shown(torque)} N·m; in a segment's frame it must be zero: the "
            "force acts at the contact point of the segment, and elsewhere in the base frame"
        )
    if not np.isfinite(torque).all():
        raise ContractError(f"wrench.torque is {_shown(torque)} N·m; it must be finite")
    return Load(segment, force, place_of(segment, force, torque))


def read_region(message: Any, frames: Frames) -> tuple[int, Array]:
    """Segment, from 1, and the ends (2, 3) of a contact's region in its frame, m.

    Raises:
        ContractError: an unknown frame, or not two finite points.
    """
    segment = frames.segment_number(message.header.frame_id)
    ends_m = np.array([[point.x, point.y, point.z] for point in message.polygon.points])
    if len(ends_m) != 2 or not np.isfinite(ends_m).all():
        raise ContractError(
            f"polygon.points is {ends_m[:4].tolist()}; it must be two finite places on the "
            "segment, m"
        )
    return segment, ends_m


def _shown(vector: Array) -> str:
    return "(" + ", ".join(f"{component:g}" for component in vector) + ")"


class Level(IntEnum):
    """Severity, as `diagnostic_msgs/DiagnosticStatus` numbers it."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class ForceState(Enum):
    """The state of an estimator's wrench; the value is the message of `~/status`."""

    FREE = "free"
    CONTACT = "contact"
    MOMENT = "moment"
    UNCONFIRMED = "unconfirmed"
    HIDDEN = "hidden"
    MOVING = "moving"
    UNTARED = "untared"
    REFUSED = "refused"
    IMPLAUSIBLE = "implausible"
    STALE = "stale"
    SILENT = "silent"

    @property
    def known(self) -> bool:
        """Whether the wrench is what is on the arm, within the stated uncertainty.

        Of `MOMENT` only its torque is: the tensions determine force times place only.
        """
        return self in (ForceState.FREE, ForceState.CONTACT, ForceState.MOMENT)

    @property
    def level(self) -> Level:
        """As severe as the status is."""
        if self in (ForceState.REFUSED, ForceState.IMPLAUSIBLE):
            return Level.ERROR
        if self in (ForceState.STALE, ForceState.SILENT):
            return Level.STALE
        return Level.OK if self.known else Level.WARN


def read_force_state(message: Any) -> tuple[ForceState, int]:
    """State and stamp, ns, in a `DiagnosticArray` of `~/status`.

    Raises:
        ContractError: not one status, or one whose message is no state.
    """
    texts = [str(status.message) for status in message.status]
    try:
        (text,) = texts
        state = ForceState(text)
    except ValueError:
        quoted = ", ".join(repr(text[:40]) for text in texts[:4]) or "nothing"
        raise ContractError(
            f"status: its message is {quoted}; it must be one of "
            f"{', '.join(known.value for known in ForceState)}"
        ) from None
    stamp = message.header.stamp
    return state, stamp.sec * 1_000_000_000 + stamp.nanosec


@dataclass(frozen=True)
class Status:
    """One line of a node's health: a level, one sentence, figures with their units in the key."""

    name: str
    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)
