"""Serialized messages into one rosbag2 MCAP file, in chunks that reach the disk as they fill.

The records are those of the library `rosbags`. What is added here: a chunk is closed and written
out every `CHUNK_S`, not only when it is large, and the file grows under its own name. A process
that is killed loses its last chunk, and `mcap_messages.McapMessages` reads what came before.
"""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from cablesense_gap.recordings.recording_error import RecordingError
from cablesense_msgs_py.qos import Qos

if TYPE_CHECKING:
    from rosbags.rosbag2.storage_mcap import McapWriter

CHUNK_S: Final = 0.5
"""A chunk holds no more than this of the messages' time."""

_BAG_VERSION: Final = 9
"""That of ROS 2 Jazzy."""


class TopicFile:
    """One .mcap file being written."""

    def __init__(self, path: str | Path, growing: bool) -> None:
        """Open the file.

        Args:
            path: of the file; one that is there already is replaced when this one is whole, or at
                once where it grows.
            growing: whether it stands under its name from the start, or only when it is whole.

        Raises:
            RecordingError: the name does not end in .mcap, or the place cannot be written to.
        """
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        self._path = Path(path)
        if self._path.suffix != ".mcap":
            raise RecordingError(f"{self._path}: a recording of topics must be named ….mcap")
        if self._path.is_dir():
            raise RecordingError(f"{self._path}: is a folder; give the name of a file")
        if not self._path.parent.is_dir():
            raise RecordingError(f"{self._path}: there is no folder {self._path.parent}")
        self._growing = growing
        self._beside = self._path.parent / f".{self._path.name}.{os.getpid()}.part"
        self._folder = self._beside / self._path.stem  # rosbags names the file for its folder
        self.store = get_typestore(Stores.ROS2_JAZZY)
        self._writer = Writer(
            self._folder, version=_BAG_VERSION, storage_plugin=StoragePlugin.MCAP
        )
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._chunk_from_ns = 0
        try:
            self._writer.open()
            self._storage.bio.flush()
            if growing:
                self._written.replace(self._path)
                shutil.rmtree(self._beside)  # nothing of it is to stay after a kill
        except OSError as error:
            self.discard()
            raise self._cannot(error) from error

    def add(self, topic: str, kind: str, qos: Qos) -> Any:
        """A channel for a topic's full name and type, to be written to; `qos` as it is offered."""
        return self._writer.add_connection(
            topic, kind, typestore=self.store, offered_qos_profiles=[_profile(qos)]
        )

    def write(self, channel: Any, log_ns: int, raw: bytes) -> None:
        """One message that came at `log_ns`.

        Raises:
            RecordingError: it cannot be written.
        """
        if not self._storage.chunk.msgs:
            self._chunk_from_ns = log_ns
        elif abs(log_ns - self._chunk_from_ns) >= CHUNK_S * 1e9:
            self.flush()
            self._chunk_from_ns = log_ns
        try:
            self._writer.write(channel, log_ns, raw)
        except OSError as error:
            raise self._cannot(error) from error

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system.

        Raises:
            RecordingError: it cannot be written.
        """
        try:
            if self._storage.chunk.msgs:
                self._storage.close_chunk()
            self._storage.bio.flush()
        except OSError as error:
            raise self._cannot(error) from error

    def close(self) -> None:
        """Finish the file, and put it in its place where it is not there yet.

        Raises:
            RecordingError: it cannot be written.
        """
        try:
            self._folder.mkdir(parents=True, exist_ok=True)  # rosbags writes its metadata there
            self._writer.close()
            if not self._growing:
                self._written.replace(self._path)
        except OSError as error:
            raise self._cannot(error) from error
        finally:
            shutil.rmtree(self._beside, ignore_errors=True)

    def discard(self) -> None:
        """Leave nothing behind."""
        with suppress(Exception):
            self._writer.abort()
        shutil.rmtree(self._beside, ignore_errors=True)
        if self._growing:
            self._path.unlink(missing_ok=True)

    @property
    def _storage(self) -> McapWriter:
        return cast("McapWriter", self._writer.storage)

    @property
    def _written(self) -> Path:
        return self._folder / f"{self._folder.name}.mcap"

    def _cannot(self, error: OSError) -> RecordingError:
        return RecordingError(f"{self._path}: cannot be written ({error.strerror or error})")


def _profile(qos: Qos) -> Any:
    from rosbags.interfaces import (
        Qos as BagQos,
    )
    from rosbags.interfaces import (
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    without_end = QosTime(9_223_372_036, 854_775_807)  # as rmw writes infinity
    return BagQos(
        history=QosHistory.KEEP_LAST,
        depth=qos.depth,
        reliability=QosReliability.RELIABLE if qos.reliable else QosReliability.BEST_EFFORT,
        durability=(
            QosDurability.TRANSIENT_LOCAL if qos.transient_local else QosDurability.VOLATILE
        ),
        deadline=without_end,
        lifespan=without_end,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=without_end,
        avoid_ros_namespace_conventions=False,
    )
