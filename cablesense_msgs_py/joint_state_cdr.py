"""A reader of serialized `sensor_msgs/JointState` (CDR), faster than making a message of it.

Layout after the four bytes of encapsulation, every number aligned to its size from there on::

    int32 sec, uint32 nanosec, string frame_id, string[] name, double[] position, velocity, effort

A sequence is a uint32 count and its elements; a string a uint32 length, which counts the closing
NUL, and its bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_msgs_py.contract_error import ContractError

MAX_NAMES = 4096
"""Far more joints than any arm has; a larger count is a malformed message."""

_ENCAPSULATION_BYTES = 4
_TEXT_AT = 12
_KNOWN_TEXTS = 16
_BYTE_ORDERS = {0: ">", 1: "<"}


@dataclass(frozen=True, slots=True)
class JointStateArrays:
    """A joint state as arrays; the arrays are read-only views of the serialized message.

    Attributes:
        stamp_ns: time of the sample in ns; 0 when the publisher set none.
        names: as sent.
        position, velocity, effort: each of any length, as sent.
    """

    stamp_ns: int
    names: tuple[str, ...]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    effort: NDArray[np.float64]


class JointStateReader:
    """Reads serialized joint states; remembers recent names so as not to decode them again."""

    def __init__(self) -> None:
        self._known: dict[bytes, tuple[str, ...]] = {}
        self._text_length = 0
        self._known_order = b""

    def read(self, raw: bytes) -> JointStateArrays:
        """Read one message, of either byte order.

        Raises:
            ContractError: the bytes end too early, or are no CDR joint state.
        """
        if len(raw) < _TEXT_AT + 4 or raw[0] != 0 or raw[1] not in _BYTE_ORDERS:
            raise ContractError(
                f"{len(raw)} bytes beginning {raw[:4].hex()} are no serialized JointState; "
                "plain CDR begins 0000 or 0001 and has at least 16 bytes"
            )
        order = _BYTE_ORDERS[raw[1]]
        seconds, nanoseconds = struct.unpack_from(order + "iI", raw, _ENCAPSULATION_BYTES)
        if nanoseconds >= 1_000_000_000:
            raise ContractError(
                f"header.stamp.nanosec is {nanoseconds}; it must be below 1000000000"
            )
        names, at = self._names(raw, order)
        position, at = _doubles(raw, at, order, "position")
        velocity, at = _doubles(raw, at, order, "velocity")
        effort, at = _doubles(raw, at, order, "effort")
        return JointStateArrays(
            seconds * 1_000_000_000 + nanoseconds, names, position, velocity, effort
        )

    def _names(self, raw: bytes, order: str) -> tuple[tuple[str, ...], int]:
        """Names and where they end.

        The bytes of frame and names are looked up first; padding between strings is not always
        zero, so a few variants of the same names are kept.
        """
        end = _TEXT_AT + self._text_length
        if raw[:2] == self._known_order:
            names = self._known.get(raw[_TEXT_AT:end])
            if names is not None:
                return names, end
        names, end = _decode_names(raw, order)
        length = end - _TEXT_AT
        if (
            length != self._text_length
            or raw[:2] != self._known_order
            or len(self._known) >= _KNOWN_TEXTS
        ):
            self._known.clear()
            self._text_length, self._known_order = length, raw[:2]
        self._known[raw[_TEXT_AT:end]] = names
        return names, end


def _decode_names(raw: bytes, order: str) -> tuple[tuple[str, ...], int]:
    _, at = _string(raw, _TEXT_AT, order, "header.frame_id")
    count, at = _count(raw, at, order, "name")
    if count > MAX_NAMES:
        raise ContractError(f"name has {count} entries; at most {MAX_NAMES} can be true")
    names = []
    for number in range(count):
        name, at = _string(raw, at, order, f"name[{number}]")
        names.append(name)
    return tuple(names), at


def _aligned(at: int, size: int) -> int:
    return at + (_ENCAPSULATION_BYTES - at) % size


def _count(raw: bytes, at: int, order: str, field: str) -> tuple[int, int]:
    at = _aligned(at, 4)
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
    try:
        text = content.removesuffix(b"\0").decode("utf-8")
    except UnicodeDecodeError as error:
        raise ContractError(f"{field}: not UTF-8 text ({error.reason})") from error
    return text, at + length


def _doubles(raw: bytes, at: int, order: str, field: str) -> tuple[NDArray[np.float64], int]:
    count, at = _count(raw, at, order, field)
    if count:
        at = _aligned(at, 8)
    if 8 * count > len(raw) - at:
        raise ContractError(
            f"{field}: {count} values announced, {max(0, len(raw) - at) // 8} left in the message"
        )
    return np.frombuffer(raw, dtype=order + "f8", count=count, offset=at), at + 8 * count
