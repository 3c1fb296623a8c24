"""Serialized messages (CDR) read, written and stamped without making message objects of them.

Many times faster than rclpy's own conversion. Numbers lie in the byte order that the first two of
four bytes of encapsulation name, each aligned to its size from there on. A sequence is a uint32
count and its elements; a string a uint32 length, which counts the closing NUL, and its bytes. A
`sensor_msgs/JointState` is::

    int32 sec, uint32 nanosec, string frame_id, string[] name, double[] position, velocity, effort
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

from cablesense_msgs_py.topics import ContractError, Frames

MAX_MESSAGE_BYTES = 1 << 18
"""Of a message that is read; a sample of an arm with twelve cables has 400."""
MAX_NAMES = 4096
"""Far more joints than any arm has; a larger count is a malformed message."""
_STAMP_AT, _HEAD_AT = 4, 12
"""After the encapsulation, and after the stamp."""
_KNOWN_HEADS = 16
_BYTE_ORDERS = {b"\0\0": ">", b"\0\1": "<"}
_STAMPS = {encapsulation: struct.Struct(f"{o}iI") for encapsulation, o in _BYTE_ORDERS.items()}


class Efforts(NamedTuple):
    """Efforts as sent.

    Attributes:
        stamp_ns: time of the sample, ns; 0 when the publisher set none.
        names: one per joint.
        values: of any length.
    """

    stamp_ns: int
    names: tuple[str, ...]
    values: tuple[float, ...]


class _Head(NamedTuple):
    """What precedes the efforts' values: names, their layout, and where they lie."""

    names: tuple[str, ...]
    values: struct.Struct
    values_at: int


class EffortReader:
    """Reads serialized joint states; knows recent heads again, so that only values are decoded.

    Padding between strings is not always zero, so several heads with the same names may be kept.
    """

    def __init__(self) -> None:
        self._known: dict[bytes, _Head] = {}
        self._values_at = 0
        self._encapsulation = b""
        self._stamp = _STAMPS[b"\0\1"]

    def read(self, raw: bytes) -> Efforts:
        """Read one message, of either byte order.

        Raises:
            ContractError: the bytes end too early, are too many, or are no CDR joint state.
        """
        head = None
        if raw[:2] == self._encapsulation:
            head = self._known.get(raw[_HEAD_AT : self._values_at])
        if head is None:
            head = self._read_head(raw)
        _, layout, at = head
        if at + layout.size > len(raw):
            raise ContractError(
                f"effort: {layout.size // 8} values announced, "
                f"{max(0, len(raw) - at) // 8} left in the message"
            )
        seconds, nanoseconds = self._stamp.unpack_from(raw, _STAMP_AT)
        if nanoseconds >= 1_000_000_000:
            raise ContractError(
                f"header.stamp.nanosec is {nanoseconds}; it must be below 1000000000"
            )
        stamp_ns = seconds * 1_000_000_000 + nanoseconds
        return Efforts(stamp_ns, head.names, layout.unpack_from(raw, at))

    def _read_head(self, raw: bytes) -> _Head:
        require_bounded(raw)
        encapsulation = raw[:2]
        order = _BYTE_ORDERS.get(encapsulation)
        if order is None or len(raw) < _HEAD_AT:
            raise ContractError(
                f"{len(raw)} bytes beginning {raw[:4].hex()} are no serialized JointState; "
                "plain CDR begins 0000 or 0001"
            )
        head = _decode_head(raw, order)
        same_kind = head.values_at == self._values_at and encapsulation == self._encapsulation
        if not same_kind or len(self._known) >= _KNOWN_HEADS:
            self._known.clear()
            self._values_at, self._encapsulation = head.values_at, encapsulation
            self._stamp = _STAMPS[encapsulation]
        self._known[raw[_HEAD_AT : head.values_at]] = head
        return head


def require_bounded(raw: bytes) -> None:
    """Nothing, where a message may be parsed.

    Raises:
        ContractError: it is longer than any message of the contract.
    """
    if len(raw) > MAX_MESSAGE_BYTES:
        raise ContractError(
            f"{len(raw)} bytes; a message of this topic has at most {MAX_MESSAGE_BYTES}"
        )


def _decode_head(raw: bytes, order: str) -> _Head:
    _, at = _string(raw, _HEAD_AT, order, "header.frame_id")
    count, at = _count(raw, at, order, "name")
    if count > MAX_NAMES:
        raise ContractError(f"name has {count} entries; at most {MAX_NAMES} can be true")
    names = []
    for number in range(count):
        name, at = _string(raw, at, order, f"name[{number}]")
        names.append(name)
    for field in ("position", "velocity"):
        count, at = _doubles(raw, at, order, field)
        at += 8 * count
    count, at = _doubles(raw, at, order, "effort")
    return _Head(tuple(names), struct.Struct(f"{order}{count}d"), at)


def _count(raw: bytes, at: int, order: str, field: str) -> tuple[int, int]:
    at += -at % 4
    if at + 4 > len(raw):
        raise ContractError(f"{field}: the message ends after {len(raw)} bytes, before its length")
    (count,) = struct.unpack_from(order + "I", raw, at)
    return count, at + 4


def _string(raw: bytes, at: int, order: str, field: str) -> tuple[str, int]:
    length, at = _count(raw, at, order, field)
    if length > len(raw) - at:
        raise ContractError(
            f"{field}: {length} bytes announced, {len(raw) - at} left in the message"
        )
    content = raw[at : at + length]
    if content[-1:] not in (b"\0", b""):
        raise ContractError(f"{field}: {length} bytes that do not end with a NUL; a string does")
    try:
        text = content[:-1].decode("utf-8")
    except UnicodeDecodeError as error:
        raise ContractError(f"{field}: not UTF-8 text ({error.reason})") from error
    return text, at + length


def _doubles(raw: bytes, at: int, order: str, field: str) -> tuple[int, int]:
    """How many values, and where the first lies."""
    count, at = _count(raw, at, order, field)
    if count:
        at += (_STAMP_AT - at) % 8  # aligned from after the encapsulation
    if 8 * count > len(raw) - at:
        raise ContractError(
            f"{field}: {count} values announced, {max(0, len(raw) - at) // 8} left in the message"
        )
    return count, at


class WrenchWriter:
    """Writes wrenches in one frame."""

    def __init__(self, frame_id: str) -> None:
        text = frame_id.encode() + b"\0"
        before = 4 + 8 + 4 + len(text)
        padding = (4 - before) % 8  # numbers of eight bytes align from after the encapsulation
        self._layout = struct.Struct(f"<4siII{len(text)}s{padding}x6d")
        self._text = text

    def write(self, stamp_ns: int, wrench: Sequence[float]) -> bytes:
        """A stamped message of a force, N, and a torque, N·m: (6,) together."""
        stamp = divmod(stamp_ns, 1_000_000_000)
        return self._layout.pack(b"\0\1", *stamp, len(self._text), self._text, *wrench)


def wrench_writers(frames: Frames) -> list[WrenchWriter]:
    """Writers in the base frame, for no contact, and in the frames of segments 1 … N."""
    names = (frames.base, *(frames.segment(n + 1) for n in range(frames.segment_count)))
    return [WrenchWriter(name) for name in names]


def stamp_ns(raw: bytes) -> int:
    """Its stamp, ns; 0 when the publisher set none.

    Raises:
        ContractError: the bytes are no message with a header.
    """
    layout = _STAMPS.get(raw[:2])
    if layout is None or len(raw) < _HEAD_AT:
        raise ContractError(
            f"{len(raw)} bytes beginning {raw[:4].hex()} are no message with a stamp in plain CDR"
        )
    seconds, nanoseconds = layout.unpack_from(raw, _STAMP_AT)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def restamped(raw: bytes, stamp: int) -> bytes:
    """The same message with another stamp, ns.

    Raises:
        ContractError: the bytes are no message with a header.
    """
    stamp_ns(raw)
    return raw[:_STAMP_AT] + _STAMPS[raw[:2]].pack(*divmod(stamp, 1_000_000_000)) + raw[_HEAD_AT:]
