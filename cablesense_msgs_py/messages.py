"""Values to and from ROS messages: named arrays, contacts and their markers, loads, health.

Message classes are passed in, so that nothing here needs ROS. Of a `sensor_msgs/JointState`
tensions are the efforts and joint angles the positions.
"""

from __future__ import annotations

import array
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from operator import itemgetter
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
ARROW_M_PER_N = 0.004
"""Length of the arrow per newton: 50 N are 0.2 m."""
_SPHERE_DIAMETER_M = 0.03
_ARROW_DIAMETERS_M = (0.012, 0.024, 0.03)  # shaft, head and head length
_COLOUR = (0.95, 0.35, 0.1, 1.0)


class NamedOrder:
    """Arranges named values in the order of `names`, whatever order they come in.

    A message that repeats the names of the one before costs one comparison and one indexing.
    """

    def __init__(self, names: Sequence[str], what: str) -> None:
        """`names` is the order wanted; `what` says in errors what they name ("cables")."""
        self.names = tuple(names)
        self._what = what
        self._last_names: tuple[str, ...] = self.names
        self._getter: itemgetter[tuple[float, ...]] | None = None

    def arrange(self, names: Sequence[str], values: Sequence[float], field: str) -> Array:
        """As `pick`, as an array."""
        return np.array(self.pick(names, values, field), dtype=np.float64)

    def pick(self, names: Sequence[str], values: Sequence[float], field: str) -> tuple[float, ...]:
        """The values, one per name of a message, in the order wanted; `field` is for errors.

        Raises:
            ContractError: a name is missing, unknown or repeated, or there is not one value per
                name.
        """
        given = tuple(names)
        if given != self._last_names:
            self._getter = self._make_getter(given)
            self._last_names = given
        if len(values) != len(given):
            raise ContractError(
                f"{field} holds {len(values)} values for {len(given)} names; "
                f"it must hold one per name ({len(self.names)})"
            )
        return tuple(values) if self._getter is None else self._getter(values)

    def _make_getter(self, given: tuple[str, ...]) -> itemgetter[tuple[float, ...]] | None:
        if given == self.names:
            return None
        counts = Counter(given)
        wrong = {
            "missing": [name for name in self.names if name not in counts],
            "unknown": [name for name in counts if name not in self.names],
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
        return itemgetter(*(given.index(name) for name in self.names))


def put_tensions(message: Any, tensions_n: Array) -> None:
    """Put (M,) tensions in N into a `JointState` whose names are set already."""
    message.effort = array.array("d", tensions_n.tolist())


def put_joint_angles(message: Any, angles_rad: Array) -> None:
    """Put (2N,) joint angles in rad into a `JointState` whose names are set already."""
    message.position = array.array("d", angles_rad.tolist())


def joint_command_rad(message: Any, order: NamedOrder, present_rad: Array | None = None) -> Array:
    """The (2N,) joint angles that a `JointState` commands, in the arm's order.

    It may name other machines' joints, and some of this arm's: the others keep their `present_rad`
    (2N,), straight where there is none.

    Raises:
        ContractError: none of the arm's joints is named, or one repeatedly, or an angle is not
            finite or out of reach.
    """
    names, angles = message.name, message.position
    if tuple(names) != order.names:
        if len(angles) != len(names):
            raise ContractError(f"position holds {len(angles)} values for {len(names)} names")
        of_arm = {name: i for i, name in enumerate(order.names)}
        named = [
            (of_arm[name], angle)
            for name, angle in zip(names, angles, strict=True)
            if name in of_arm
        ]
        if not named or len(dict(named)) < len(named):
            order.pick(names, angles, "position")  # says what is wrong
        angles = np.zeros(len(of_arm)) if present_rad is None else present_rad.copy()
        for place, angle in named:
            angles[place] = angle
    command = np.array(order.pick(order.names, angles, "position"), dtype=np.float64)
    for name, angle in zip(order.names, command, strict=True):
        if not abs(angle) <= MAX_JOINT_ANGLE_RAD:
            raise ContractError(
                f"position of {name} is {angle:g} rad; it must be finite and within "
                f"±{MAX_JOINT_ANGLE_RAD:.3f} rad (a third of pi)"
            )
    return command


def cable_offsets_m(message: Any, order: NamedOrder) -> Array:
    """The (M,) lengths that a `JointState` adds to the cables' commanded ones, in the arm's order.

    Raises:
        ContractError: a cable is missing, unknown or repeated, or a length is not finite or too
            large.
    """
    offsets = order.arrange(message.name, message.position, "position")
    for name, offset in zip(order.names, offsets, strict=True):
        if not abs(offset) <= MAX_CABLE_OFFSET_M:
            raise ContractError(
                f"position of {name} is {offset:g} m; an offset must be finite and within "
                f"±{MAX_CABLE_OFFSET_M:g} m"
            )
    return offsets


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
    """Where and how the environment pushes the arm, or that it does not.

    Attributes:
        segment: the touched segment, counted from 1; 0 when nothing touches.
        angle_deg: direction of the force in the plane normal to the segment at the commanded joint
            angles, from +z towards +y of that segment's frame.
        magnitude_n: of the force, N.
        contact_m: distance of the contact point from the segment's joint centre, along its axis.
    """

    segment: int = 0
    angle_deg: float = 0.0
    magnitude_n: float = 0.0
    contact_m: float = 0.0

    @property
    def direction(self) -> tuple[float, float]:
        """(y, z) of the force's unit vector in the segment's frame; x is zero."""
        angle = math.radians(self.angle_deg)
        return math.sin(angle), math.cos(angle)

    @property
    def wrench(self) -> tuple[float, float, float, float, float, float]:
        """The force, N, and its moment about the origin of the segment's frame, N·m."""
        y, z = (self.magnitude_n * component for component in self.direction)
        return 0.0, y, z, 0.0, -self.contact_m * z, self.contact_m * y


NO_CONTACT = Contact()
UNKNOWN_WRENCH = (math.nan,) * 6
"""Where an unknown force is published as not a number."""


def put_contact_point(message: Any, contact: Contact, frames: Frames) -> None:
    """Put the point of a contact into a `PointStamped` in the touched segment's frame."""
    message.header.frame_id = frames.segment(contact.segment)
    message.point.x = contact.contact_m


def put_force_direction(message: Any, contact: Contact, frames: Frames) -> None:
    """Put a force's unit vector into a `Vector3Stamped` in the touched segment's frame."""
    message.header.frame_id = frames.segment(contact.segment)
    message.vector.y, message.vector.z = contact.direction


def put_probabilities(message: Any, probabilities: Sequence[float]) -> None:
    """Put P(no contact), P(segment 1), … into a `Float64MultiArray` whose layout is set."""
    message.data = array.array("d", probabilities)


def describe_probabilities(dimension: Any, segment_count: int) -> None:
    """Fill the `MultiArrayDimension` that states what the probabilities belong to."""
    dimension.label = "none," + ",".join(f"segment_{n + 1}" for n in range(segment_count))
    dimension.size = dimension.stride = segment_count + 1


class ContactMarkers:
    """Fills a `MarkerArray` made once; each arrow ends at a contact point, as a push does."""

    def __init__(
        self,
        array: Any,
        make_marker: Callable[[], Any],
        make_point: Callable[[], Any],
        most: int = 1,
    ) -> None:
        """`array` is an empty `MarkerArray`; the classes are `Marker` and `Point`.

        `most` contacts are shown.
        """
        self.array = array
        array.markers = [make_marker() for _ in range(2 * most)]
        for number, marker in enumerate(array.markers):
            marker.ns = "contact"
            marker.id = number
            marker.pose.orientation.w = 1.0
            marker.color.r, marker.color.g, marker.color.b, marker.color.a = _COLOUR
        self._pairs = list(zip(array.markers[::2], array.markers[1::2], strict=True))
        for arrow, sphere in self._pairs:
            arrow.type, sphere.type = arrow.ARROW, sphere.SPHERE
            arrow.scale.x, arrow.scale.y, arrow.scale.z = _ARROW_DIAMETERS_M
            sphere.scale.x = sphere.scale.y = sphere.scale.z = _SPHERE_DIAMETER_M
            arrow.points = [make_point(), make_point()]

    def put(self, contacts: Sequence[Contact], frames: Frames, stamp: Any) -> None:
        """Show contacts, or take the markers of those away that are not there."""
        none = (NO_CONTACT,) * (len(self._pairs) - len(contacts))
        for (arrow, sphere), contact in zip(self._pairs, (*contacts, *none), strict=True):
            frame_id = frames.segment(contact.segment) if contact.segment else frames.base
            for marker in (arrow, sphere):
                marker.header.stamp = stamp
                marker.header.frame_id = frame_id
                marker.action = marker.ADD if contact.segment else marker.DELETE
            y, z = contact.direction
            length = ARROW_M_PER_N * contact.magnitude_n
            tail, tip = arrow.points
            tail.x = tip.x = sphere.pose.position.x = contact.contact_m
            tail.y, tail.z = -length * y, -length * z


_OFF_LINE_M = 0.03
"""An arm under load is elsewhere than where it is commanded, by less than this."""


@dataclass(frozen=True)
class Load:
    """A force (3,) in N, base axes, at the contact point of segment `segment` (counted from 1)."""

    segment: int
    force_base_n: Array


def read_load(message: Any, frames: Frames, contacts_m: Callable[[], Array] | None = None) -> Load:
    """The load that a `WrenchStamped` describes.

    In the base frame it is a wrench as tf2 understands one, whose torque about the frame's origin
    states where the force acts; `contacts_m` gives the contact points (N, 3) of the present pose.
    In the frame of a segment the force acts at its contact point, in base axes all the same.

    Raises:
        ContractError: an unknown frame, a force that is not finite or too large, a torque that
            the force does not have at the contact point of one segment.
    """
    force, torque = (
        (vector.x, vector.y, vector.z) for vector in (message.wrench.force, message.wrench.torque)
    )
    if not math.hypot(*force) <= MAX_LOAD_N:
        raise ContractError(
            f"wrench.force is {_shown(force)} N; it must be finite, at most {MAX_LOAD_N:g} N"
        )
    if contacts_m is not None and message.header.frame_id == frames.base:
        segment = _segment_on_line(np.array(force), np.array(torque), contacts_m())
        return Load(segment, np.array(force, dtype=np.float64))
    segment = frames.segment_number(message.header.frame_id)
    if any(component != 0.0 for component in torque):
        raise ContractError(
            f"wrench.torque is {_shown(torque)} N·m; it must be zero: "
            "a load is a force at the contact point of the segment"
        )
    return Load(segment, np.array(force, dtype=np.float64))


def _segment_on_line(force_n: Array, torque_n_m: Array, contacts_m: Array) -> int:
    """The segment, from 1, through whose contact point a force acts, by its torque."""
    size_n = float(np.linalg.norm(force_n))
    if size_n == 0.0:
        raise ContractError(
            "wrench.force is zero in the base frame; a zero force in a segment's frame releases it"
        )
    off_m = np.linalg.norm(torque_n_m - np.cross(contacts_m, force_n), axis=-1) / size_n
    nearest, *others = np.sort(off_m)
    if not nearest <= min([_OFF_LINE_M, *(each / 3.0 for each in others[:1])]):
        raise ContractError(
            f"wrench.torque is {_shown(tuple(torque_n_m))} N·m: the force acts "
            f"{', '.join(f'{1e3 * each:.0f}' for each in off_m)} mm beside the contact points of "
            "the segments; it must act at one, with its torque about the frame's origin"
        )
    return int(np.argmin(off_m)) + 1


def _shown(vector: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{component:g}" for component in vector) + ")"


class Level(IntEnum):
    """Severity, as `diagnostic_msgs/DiagnosticStatus` numbers it."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class ForceState(Enum):
    """What an estimator's wrench stands for; the value is the message of `~/status`."""

    FREE = "free"
    CONTACT = "contact"
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
        """Whether the wrench is the force on the arm, within the stated uncertainty."""
        return self in (ForceState.FREE, ForceState.CONTACT)

    @property
    def level(self) -> Level:
        """As severe as the status is."""
        return _LEVELS.get(self, Level.WARN)


_LEVELS = {
    ForceState.FREE: Level.OK,
    ForceState.CONTACT: Level.OK,
    ForceState.REFUSED: Level.ERROR,
    ForceState.IMPLAUSIBLE: Level.ERROR,
    ForceState.STALE: Level.STALE,
    ForceState.SILENT: Level.STALE,
}


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
        given = ", ".join(repr(text[:40]) for text in texts[:4]) or "nothing"
        raise ContractError(
            f"status: its message is {given}; it must be one of "
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


def diagnostic_statuses(
    statuses: Iterable[Status],
    node_name: str,
    hardware_id: str,
    make_status: Callable[..., Any],
    make_value: Callable[..., Any],
) -> list[Any]:
    """The statuses as messages, of the classes `DiagnosticStatus` and `KeyValue`.

    `node_name` goes before each name (REP-107); `hardware_id` is the arm's identity.
    """
    return [
        make_status(
            level=bytes([status.level]),
            name=f"{node_name}: {status.name}",
            message=status.message,
            hardware_id=hardware_id,
            values=[make_value(key=key, value=value) for key, value in status.values.items()],
        )
        for status in statuses
    ]
