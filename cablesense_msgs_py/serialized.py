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
"""The most of a message that is read; a sample of an arm with twelve cables has 400."""
MAX_CALIBRATION_BYTES = 1 << 25
"""The same of a calibration, with the covariance of all parameters; twelve cables have 170 kB."""
MAX_NAMES = 4096
"""Far more joints than any arm has; a larger count is a malformed message."""
_STAMP_AT = 4
"""Byte of the stamp in a serialized message: after the encapsulation."""
_HEAD_AT = 12
"""Byte of what follows the stamp."""
_BYTE_ORDERS = {b"\0\0": ">", b"\0\1": "<"}
_STAMPS = {encapsulation: struct.Struct(f"{o}iI") for encapsulation, o in _BYTE_ORDERS.items()}


class Efforts(NamedTuple):
    """Efforts as sent: one name per joint, values of any length, 0 for a stamp that is not set."""

    stamp_ns: int
    names: tuple[str, ...]
    values: tuple[float, ...]


class EffortReader:
    """Reads serialized joint states; where the head is as before, only values are decoded."""

    def __init__(self) -> None:
        self._encapsulation: bytes | None = None
        self._head = b""
        self._names: tuple[str, ...] = ()
        self._values = struct.Struct("")

    def read(self, raw: bytes) -> Efforts:
        """Read one message, of either byte order.

        Raises:
            ContractError: the bytes end too early, are too many, or are no CDR joint state.
        """
        values_at = _HEAD_AT + len(self._head)
        if raw[:2] != self._encapsulation or raw[_HEAD_AT:values_at] != self._head:
            values_at = self._read_head(raw)
        if values_at + self._values.size > len(raw):
            raise ContractError(
                f"effort: {self._values.size // 8} values announced, "
                f"{max(0, len(raw) - values_at) // 8} left in the message"
            )
        seconds, nanoseconds = _STAMPS[raw[:2]].unpack_from(raw, _STAMP_AT)
        if nanoseconds >= 1_000_000_000:
            raise ContractError(
                f"header.stamp.nanosec is {nanoseconds}; it must be below 1000000000"
            )
        stamp_ns = seconds * 1_000_000_000 + nanoseconds
        return Efforts(stamp_ns, self._names, self._values.unpack_from(raw, values_at))

    def _read_head(self, raw: bytes) -> int:
        """Keep what precedes the efforts, and give where these lie."""
        require_bounded(raw)
        _require_stamped(raw, "serialized JointState")
        fields = _Fields(raw, _BYTE_ORDERS[raw[:2]])
        fields.string("header.frame_id")
        count = fields.count("name")
        if count > MAX_NAMES:
            raise ContractError(f"name has {count} entries; at most {MAX_NAMES} can be true")
        names = tuple(fields.string(f"name[{number}]") for number in range(count))
        for field in ("position", "velocity"):
            count = fields.doubles(field)
            fields.at += 8 * count
        count = fields.doubles("effort")
        self._encapsulation = raw[:2]
        self._head = raw[_HEAD_AT : fields.at]
        self._names = names
        self._values = struct.Struct(f"{fields.order}{count}d")
        return fields.at


def _string(text: str) -> bytes:
    content = text.encode() + b"\0"
    return struct.pack("<I", len(content)) + content


def _align(head: bytearray, size: int) -> None:
    """Pad what follows the stamp; sizes count from after the encapsulation."""
    head += b"\0" * ((_STAMP_AT - _HEAD_AT - len(head)) % size)


class EffortWriter:
    """Writes joint states of some names that hold efforts alone."""

    def __init__(self, names: Sequence[str]) -> None:
        head = bytearray(_string(""))  # frame_id
        _align(head, 4)
        head += struct.pack("<I", len(names))
        for name in names:
            _align(head, 4)
            head += _string(name)
        _align(head, 4)
        head += struct.pack("<3I", 0, 0, len(names))  # no positions, no velocities
        if names:
            _align(head, 8)
        self._head = bytes(head)
        self._values = struct.Struct(f"<{len(names)}d")

    def write(self, stamp_ns: int, efforts: Sequence[float]) -> bytes:
        """A stamped message with one effort for each name."""
        stamp = _STAMPS[b"\0\1"].pack(*divmod(stamp_ns, 1_000_000_000))
        return b"\0\1\0\0" + stamp + self._head + self._values.pack(*efforts)


def require_bounded(raw: bytes, most: int = MAX_MESSAGE_BYTES) -> None:
    """Raise a `ContractError` for what is longer than any message of its topic, unparsed."""
    if len(raw) > most:
        raise ContractError(f"{len(raw)} bytes; a message of this topic has at most {most}")


class _Fields:
    """Reads a message after its stamp, field by field; `at` is where the next one begins."""

    def __init__(self, raw: bytes, order: str) -> None:
        self.raw = raw
        self.order = order
        self.at = _HEAD_AT

    def count(self, field: str) -> int:
        self.at += -self.at % 4
        if self.at + 4 > len(self.raw):
            raise ContractError(
                f"{field}: the message ends after {len(self.raw)} bytes, before its length"
            )
        (count,) = struct.unpack_from(self.order + "I", self.raw, self.at)
        self.at += 4
        return int(count)

    def string(self, field: str) -> str:
        length = self.count(field)
        content = self.raw[self.at : self.at + length]
        self._require_left(field, length, "bytes", 1)
        self.at += length
        try:
            text = content.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ContractError(f"{field}: not UTF-8 text ({error.reason})") from error
        if text and not text.endswith("\0"):
            raise ContractError(
                f"{field}: {length} bytes that do not end with a NUL; a string does"
            )
        return text[:-1]

    def doubles(self, field: str) -> int:
        """How many there are; `at` is where the first lies."""
        count = self.count(field)
        if count:
            self.at += (_STAMP_AT - self.at) % 8  # aligned from after the encapsulation
        self._require_left(field, count, "values", 8)
        return count

    def _require_left(self, field: str, count: int, what: str, size: int) -> None:
        remaining = max(0, len(self.raw) - self.at) // size
        if count > remaining:
            raise ContractError(
                f"{field}: {count} {what} announced, {remaining} left in the message"
            )


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


def _require_stamped(raw: bytes, what: str = "message with a stamp") -> None:
    if raw[:2] not in _STAMPS or len(raw) < _HEAD_AT:
        raise ContractError(
            f"{len(raw)} bytes beginning {raw[:4].hex()} are no {what}; plain CDR begins 0000 or "
            "0001"
        )


def stamp_ns(raw: bytes) -> int:
    """The stamp of a message with a header, ns; 0 when the publisher set none.

    Raises:
        ContractError: the bytes are no message with a header.
    """
    _require_stamped(raw)
    seconds, nanoseconds = _STAMPS[raw[:2]].unpack_from(raw, _STAMP_AT)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def restamped(raw: bytes, stamp: int) -> bytes:
    """The same message with another stamp, ns; errors as of `stamp_ns`."""
    _require_stamped(raw)
    return raw[:_STAMP_AT] + _STAMPS[raw[:2]].pack(*divmod(stamp, 1_000_000_000)) + raw[_HEAD_AT:]
