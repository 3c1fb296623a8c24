"""Serialized messages in MCAP files: read from first to last, and written in chunks.

A recorder that is killed leaves a file without its end. The part already written must still be
readable: files are read record by record (https://mcap.dev/spec), not by the index at the end, and
a chunk is closed every `CHUNK_S`. The library `mcap` reads records, and `rosbags` writes them. The
rest is done here: `mcap` does not distinguish a file that breaks off from a damaged one, trusts
every length and unpacks without bound, and no writer closes chunks by time.
"""

from __future__ import annotations

import os
import shutil
import struct
from array import array
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from cablesense_base.files import output_file
from cablesense_msgs_py.qos import Qos
from cablesense_recording.recording import RecordingError

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord
    from rosbags.rosbag2.storage_mcap import McapWriter

MOST_RECORD_BYTES: Final = 64 << 20
"""Limit of a chunk, packed and unpacked, and of any other record; rosbag2 writes 1 MB chunks."""
_UNPACKED_BYTES: Final = 4 << 20
_UNPACKED_TIMES: Final = 100
"""All chunks unpack to at most those bytes and this multiple of the size of the file. Tensions are
far from it, and equal messages of a kilobyte reach half of it."""
CHUNK_S: Final = 0.5
"""A chunk holds no more than this of the messages' time."""

_MAGIC: Final = b"\x89MCAP0\r\n"
LEAST_BYTES: Final = len(_MAGIC)
"""A file that is shorter was begun and never written to."""
_HEAD = struct.Struct("<BQ")
_BAG_VERSION: Final = 9
"""That of ROS 2 Jazzy."""


class RawMessage(NamedTuple):
    """One message as it was recorded: its topic's full name and type, when it came, its bytes."""

    topic: str
    kind: str
    log_ns: int
    data: bytes


class McapMessages:
    """The messages of a file, whole or broken off.

    Attributes:
        cut: where the file breaks off, once it has been gone through; empty if it is whole.
    """

    def __init__(self, path: str | Path) -> None:
        """The file is opened when messages are asked for."""
        self._path = Path(path)
        self.cut = ""

    def __iter__(self) -> Iterator[RawMessage]:
        """The messages; those of a chunk in the order of their times.

        Raises:
            RecordingError: no such file, no MCAP, or damaged before its end.
        """
        self.cut = ""
        try:
            if not self._path.exists():
                raise RecordingError(f"{self._path}: no such file")
            if not self._path.is_file():  # to open a pipe would wait for ever
                raise RecordingError(f"{self._path}: not a file")
            with self._path.open("rb") as file:
                yield from self._messages(file, self._path.stat().st_size)
        except OSError as error:
            raise RecordingError(f"{self._path}: cannot be read ({error})") from error

    def _messages(self, file: BinaryIO, size: int) -> Iterator[RawMessage]:
        from mcap.exceptions import McapError
        from mcap.opcode import Opcode
        from mcap.records import Channel, Message, Schema
        from zstandard import ZstdError

        kinds: dict[int, str] = {}
        channels: dict[int, tuple[str, str]] = {}
        bytes_left = _UNPACKED_BYTES + _UNPACKED_TIMES * size
        for offset, opcode, content in self._records(file, size):
            if opcode == Opcode.CHUNK:
                bytes_left -= int.from_bytes(content[16:24], "little")  # its size unpacked
            try:
                for record in _parsed(opcode, content, bytes_left):
                    if isinstance(record, Schema):
                        kinds[record.id] = (
                            record.name if record.encoding.startswith("ros2") else ""
                        )
                    elif isinstance(record, Channel):
                        kind = kinds.get(record.schema_id, "")
                        kind = kind if record.message_encoding == "cdr" else ""
                        channels[record.id] = record.topic, kind
                    elif isinstance(record, Message):
                        if record.channel_id not in channels:
                            raise ValueError(f"a message of unknown channel {record.channel_id}")
                        topic, kind = channels[record.channel_id]
                        if kind:
                            yield RawMessage(topic, kind, record.log_time, record.data)
            except (
                McapError,
                ZstdError,
                struct.error,
                ValueError,
                RuntimeError,
                EOFError,
                OverflowError,
            ) as error:
                why = str(error) or type(error).__name__
                raise self._damaged(offset, why) from error

    def _records(self, file: BinaryIO, size: int) -> Iterator[tuple[int, int, bytes]]:
        """Start of each record, its opcode and content; nothing longer than the bound."""
        from mcap.opcode import Opcode

        read = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK}
        begin = file.read(len(_MAGIC))
        if size < LEAST_BYTES:
            raise RecordingError(
                f"{self._path}: has {size} bytes, so it is no MCAP file; its recorder was stopped "
                "before it wrote anything"
            )
        if begin != _MAGIC:
            raise RecordingError(f"{self._path}: no MCAP file; `ros2 bag info` should know it")
        offset = len(_MAGIC)
        while True:
            head = file.read(_HEAD.size)
            opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            if opcode == 0 or length > size - offset - _HEAD.size:
                self.cut = f"breaks off at byte {offset} of {size}: the recorder did not finish it"
                return
            if opcode not in read:
                file.seek(length, os.SEEK_CUR)
            elif length > MOST_RECORD_BYTES:
                raise self._damaged(offset, f"a record of {length} bytes")
            else:
                yield offset, opcode, file.read(length)
            offset += _HEAD.size + length

    def _damaged(self, at: int, why: str) -> RecordingError:
        return RecordingError(
            f"{self._path}: damaged at byte {at} ({why}); `mcap recover` may save the rest"
        )


def _parsed(opcode: int, content: bytes, left: int) -> list[McapRecord]:
    """The record of these bytes; of a chunk all in it, messages in the order of their times.

    After the chunk `left` bytes may still be unpacked.
    """
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Chunk
    from mcap.stream_reader import breakup_chunk

    if opcode == Opcode.CHUNK:
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
        chunk = replace(chunk, compression="", data=_unpacked(chunk, left))
    else:
        record = _HEAD.pack(opcode, len(content)) + content
        chunk = Chunk("", record, 0, 0, 0, len(record))
    records = breakup_chunk(chunk, validate_crc=True)
    return sorted(records, key=lambda record: getattr(record, "log_time", -1))


def _unpacked(chunk: Chunk, left: int) -> bytes:
    """A chunk's records; no more than it states is unpacked, whatever the packed bytes hold."""
    size = chunk.uncompressed_size
    if size > MOST_RECORD_BYTES:
        raise ValueError(f"a chunk of {size} bytes")
    if left < 0:
        raise ValueError(f"chunks of more than {_UNPACKED_TIMES} times the bytes of the file")
    if chunk.compression == "zstd":
        from zstandard import ZstdDecompressor

        records = ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        records = LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    elif chunk.compression == "":
        records = chunk.data
    else:
        raise ValueError(f"a chunk packed as {chunk.compression[:20]!r}")
    if len(records) != size:
        raise ValueError(f"a chunk that is not of the {size} bytes it states")
    return records


@cache
def _standard_types() -> Any:
    """The standard messages of ROS 2 Jazzy, without a ROS installation."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def parsed_message(raw: RawMessage) -> Any:
    """A message from its bytes (CDR).

    Bytes after its end are ignored. Other bytes raise whatever a parser can.
    """
    types = _standard_types()
    definition = types.get_msgdef(raw.kind)
    little = bytes(raw.data[:2]) == b"\x00\x01"
    read = definition.deserialize_cdr_le if little else definition.deserialize_cdr_be
    content = np.frombuffer(raw.data, dtype=np.uint8)[4:].tobytes()
    return read(content, 0, definition.cls, types)[0]


def topic_file_path(path: str | Path, force: bool) -> Path:
    """The path of a `TopicFile` of this name, links followed.

    Raises:
        RecordingError: the name does not end in .mcap, or the file must not be written.
    """
    if Path(path).suffix != ".mcap":
        raise RecordingError(f"{path}: a recording of topics must be named ….mcap")
    return output_file(path, RecordingError, force=force)


class TopicFile:
    """One rosbag2 .mcap file that grows under its name while it is written.

    A file that cannot be written raises a `RecordingError`.
    """

    def __init__(self, path: str | Path, force: bool = True) -> None:
        """Open the file, whose name ends in .mcap; `force` replaces one that is there already."""
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        self._path = topic_file_path(path, force)
        self._beside = self._path.parent / f".{self._path.name}.{os.getpid()}.part"
        self._folder = self._beside / self._path.stem  # rosbags names the file for its folder
        self._writer = Writer(
            self._folder, version=_BAG_VERSION, storage_plugin=StoragePlugin.MCAP
        )
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._chunk_from_ns = 0
        try:
            with self._refusing():
                self._writer.open()
                self._storage.bio.flush()
                (self._folder / f"{self._folder.name}.mcap").replace(self._path)
        except RecordingError:
            self._writer.abort()
            raise
        finally:
            shutil.rmtree(self._beside, ignore_errors=True)

    def add(self, topic: str, kind: str, qos: Qos) -> Any:
        """A channel for a topic's full name and type, to be written to; `qos` as it is offered."""
        return self._writer.add_connection(
            topic, kind, typestore=_standard_types(), offered_qos_profiles=[_profile(qos)]
        )

    def write(self, channel: Any, log_ns: int, raw: bytes) -> None:
        """One message that came at `log_ns`."""
        if not self._storage.chunk.msgs:
            self._chunk_from_ns = log_ns
        elif abs(log_ns - self._chunk_from_ns) >= CHUNK_S * 1e9:
            self.flush()
            self._chunk_from_ns = log_ns
        with self._refusing():
            self._writer.write(channel, log_ns, raw)

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system."""
        with self._refusing():
            if self._storage.chunk.msgs:
                self._storage.close_chunk()
            self._storage.bio.flush()

    def close(self) -> None:
        """Finish the file."""
        try:
            with self._refusing():
                self._folder.mkdir(parents=True, exist_ok=True)  # for rosbags' metadata
                self._writer.close()
        finally:
            shutil.rmtree(self._beside, ignore_errors=True)

    def discard(self) -> None:
        """Leave nothing of it behind."""
        with suppress(Exception):
            self._writer.abort()
        self._path.unlink(missing_ok=True)

    @property
    def _storage(self) -> McapWriter:
        return cast("McapWriter", self._writer.storage)

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            why = error.strerror or error
            raise RecordingError(f"{self._path}: cannot be written ({why})") from error


@dataclass
class CountedMessages:
    """Messages of one kind in the order they came, as plain arrays: objects take four times more.

    Attributes:
        counts: by message the count of all messages, its time of arrival and its stamp, ns.
        numbers: of all messages, one after the other.
    """

    counts: array[int] = field(default_factory=lambda: array("q"), kw_only=True)
    numbers: array[float] = field(default_factory=lambda: array("d"), kw_only=True)

    @property
    def counts_and_times(self) -> NDArray[np.int64]:
        """(R, 3) count of all messages, time of arrival and stamp, ns."""
        return np.array(self.counts, dtype=np.int64).reshape(-1, 3)


def _profile(qos: Qos) -> Any:
    from rosbags import interfaces as bags

    durability = bags.QosDurability
    reliability = bags.QosReliability
    without_end = bags.QosTime(9_223_372_036, 854_775_807)  # as rmw writes infinity
    return bags.Qos(
        history=bags.QosHistory.KEEP_LAST,
        depth=qos.depth,
        reliability=reliability.RELIABLE if qos.reliable else reliability.BEST_EFFORT,
        durability=durability.TRANSIENT_LOCAL if qos.transient_local else durability.VOLATILE,
        deadline=without_end,
        lifespan=without_end,
        liveliness=bags.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=without_end,
        avoid_ros_namespace_conventions=False,
    )
