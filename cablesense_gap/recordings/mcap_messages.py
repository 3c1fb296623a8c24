"""The messages of an MCAP file from first to last, also of one that breaks off.

Records stand one behind the other, each a byte of its kind, eight of its length and its content
(https://mcap.dev/spec). They are read in this order, without the index at the end, which a
recorder that was killed has not written. Lengths are looked at before anything is read or
unpacked: a file cannot ask for more memory than `MOST_RECORD_BYTES` at a time.

Recorded messages from their bytes, without a ROS installation.
"""

from __future__ import annotations

import os
import stat
import struct
from binascii import crc32
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np

from cablesense_gap.recordings.recording import RecordingError

MAGIC: Final = b"\x89MCAP0\r\n"
MOST_RECORD_BYTES: Final = 64 << 20
"""Of a chunk, packed and unpacked, and of any record outside; rosbag2's chunks have a megabyte."""

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 1, 2, 3, 4, 5, 6, 15
_READ: Final = {_HEADER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK}
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_LENGTH = struct.Struct("<I")
_IDS = struct.Struct("<HH")


class RawMessage(NamedTuple):
    """One message as it was recorded: its topic's full name and type, when it came, its bytes."""

    topic: str
    kind: str
    log_ns: int
    data: bytes


class McapMessages:
    """Goes through a file.

    Attributes:
        cut: where the file breaks off, in words, once it has been gone through; empty if whole.
    """

    def __init__(self, path: str | Path) -> None:
        """The file is opened when messages are asked for."""
        self._path = Path(path)
        self.cut = ""
        self._kinds: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str]] = {}

    def __iter__(self) -> Iterator[RawMessage]:
        """The messages; those of a chunk in the order of their times.

        Raises:
            RecordingError: no such file, no MCAP, or damaged in its midst.
        """
        self.cut = ""
        self._kinds, self._channels = {}, {}
        try:
            number = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except FileNotFoundError as error:
            raise RecordingError(f"{self._path}: no such file") from error
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self._path}: cannot be read ({error})") from error
        status = os.fstat(number)
        if not stat.S_ISREG(status.st_mode):
            os.close(number)
            raise RecordingError(f"{self._path}: not a file")
        with open(number, "rb") as file:  # noqa: PTH123  (a number has no path)
            try:
                yield from self._messages(file, status.st_size)
            except (struct.error, UnicodeDecodeError, IndexError) as error:
                raise self._damaged(file.tell(), str(error)) from error
            except OSError as error:
                raise RecordingError(f"{self._path}: cannot be read ({error})") from error

    def _messages(self, file: BinaryIO, size: int) -> Iterator[RawMessage]:
        if file.read(len(MAGIC)) != MAGIC:
            raise RecordingError(f"{self._path}: no MCAP file; `ros2 bag info` should know it")
        at = len(MAGIC)
        while True:
            head = file.read(_RECORD.size)
            if len(head) < _RECORD.size:
                return self._break_off(at, size)
            kind, length = _RECORD.unpack(head)
            if kind in (_DATA_END, _FOOTER):
                return None
            if kind == 0 or length > size - at - _RECORD.size:
                return self._break_off(at, size)
            if kind not in _READ:
                file.seek(length, os.SEEK_CUR)
            elif length > MOST_RECORD_BYTES:
                raise self._damaged(at, f"a record of {length} bytes")
            else:
                yield from self._take(kind, file.read(length), at)
            at += _RECORD.size + length

    def _take(self, kind: int, content: bytes, at: int) -> Iterator[RawMessage]:
        if kind == _SCHEMA:
            (number,) = struct.unpack_from("<H", content)
            name, behind = _text(content, 2)
            self._kinds[number] = name if _text(content, behind)[0].startswith("ros2") else ""
        elif kind == _CHANNEL:
            number, schema = _IDS.unpack_from(content)
            topic, behind = _text(content, _IDS.size)
            encoding = _text(content, behind)[0]
            self._channels[number] = (
                topic,
                self._kinds.get(schema, "") if encoding == "cdr" else "",
            )
        elif kind == _MESSAGE:
            message = self._message(content, at)
            if message is not None:
                yield message
        elif kind == _CHUNK:
            yield from sorted(self._chunk(content, at), key=lambda message: message.log_ns)

    def _chunk(self, content: bytes, at: int) -> Iterator[RawMessage]:
        _, _, unpacked_bytes, checksum = _CHUNK_HEAD.unpack_from(content)
        packing, behind = _text(content, _CHUNK_HEAD.size)
        (length,) = struct.unpack_from("<Q", content, behind)
        packed = content[behind + 8 : behind + 8 + length]
        if len(packed) != length:
            raise self._damaged(at, f"a chunk of {length} bytes in a record of {len(content)}")
        if unpacked_bytes > MOST_RECORD_BYTES:
            raise self._damaged(at, f"a chunk of {unpacked_bytes} bytes")
        records = self._unpacked(packed, packing, unpacked_bytes, at)
        if checksum and crc32(records) != checksum:
            raise self._damaged(at, "a chunk whose checksum does not fit")
        inside = 0
        while inside < len(records):
            kind, length = _RECORD.unpack_from(records, inside)
            inside += _RECORD.size
            if length > len(records) - inside or kind == _CHUNK:
                raise self._damaged(at, f"a record of {length} bytes in a chunk")
            yield from self._take(kind, records[inside : inside + length], at)
            inside += length

    def _unpacked(self, packed: bytes, packing: str, size: int, at: int) -> bytes:
        """No more than `size` is unpacked, whatever the packed bytes hold."""
        if packing == "":
            records = packed
        elif packing == "zstd":
            from backports.zstd import ZstdDecompressor, ZstdError

            try:
                records = ZstdDecompressor().decompress(packed, size + 1)
            except ZstdError as error:
                raise self._damaged(at, f"a chunk that cannot be unpacked: {error}") from error
        elif packing == "lz4":
            from lz4.frame import LZ4FrameDecompressor

            try:
                records = LZ4FrameDecompressor().decompress(packed, size + 1)
            except (RuntimeError, EOFError) as error:
                raise self._damaged(at, f"a chunk that cannot be unpacked: {error}") from error
        else:
            raise self._damaged(at, f"a chunk packed as {packing[:20]!r}")
        if len(records) != size:
            raise self._damaged(at, f"a chunk that is not of the {size} bytes it says")
        return records

    def _message(self, content: bytes, at: int) -> RawMessage | None:
        channel, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(content)
        if channel not in self._channels:
            raise self._damaged(at, f"a message of the unknown channel {channel}")
        topic, kind = self._channels[channel]
        return RawMessage(topic, kind, log_ns, content[_MESSAGE_HEAD.size :]) if kind else None

    def _break_off(self, at: int, size: int) -> None:
        self.cut = f"breaks off at byte {at} of {size}: the recorder did not get to its end"

    def _damaged(self, at: int, why: str) -> RecordingError:
        return RecordingError(
            f"{self._path}: damaged at byte {at} ({why}); `mcap recover` may save the rest"
        )


def _text(content: bytes, at: int) -> tuple[str, int]:
    """A string, and where it ends."""
    (length,) = _LENGTH.unpack_from(content, at)
    end = at + _LENGTH.size + length
    if end > len(content):
        raise IndexError(f"a string of {length} bytes in a record of {len(content)}")
    return content[at + _LENGTH.size : end].decode(), end


class BagTypes:
    """The standard messages of ROS 2 Jazzy."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS2_JAZZY)

    def message(self, kind: str, data: bytes) -> Any:
        """A message of its type's full name and its bytes (CDR).

        What publishers leave behind its end is not looked at. Bytes that are none raise anything
        that a parser can.
        """
        definition = self._store.get_msgdef(kind)
        little = bytes(data[:2]) == b"\x00\x01"
        read = definition.deserialize_cdr_le if little else definition.deserialize_cdr_be
        return read(
            np.frombuffer(data, dtype=np.uint8)[4:].tobytes(), 0, definition.cls, self._store
        )[0]
