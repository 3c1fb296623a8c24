"""Serialized messages into one rosbag2 MCAP file, in chunks that reach the disk as they fill.

The records are those of the library `rosbags`. What is added here: a chunk is closed and written
out every `CHUNK_S`, not only when it is large, and the file grows under its own name. A process
that is killed loses its last chunk, and `mcap_messages.McapMessages` reads what came before.

Writes the contract's topics to one rosbag2 MCAP file, without a ROS installation.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from cablesense_gap.recordings.recording import RecordingError
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import Qos
from cablesense_msgs_py.topic_types import INPUTS, JOINT_STATE, NUMBER, WRENCH, resolved

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


class BagWriter:
    """One .mcap file; it appears under its name when it is closed, whole.

    Times are in ns: `log_ns` when a message came, `stamp_ns` what its header says, 0 for nothing.
    A topic stands in the file once a message of it is written.
    """

    def __init__(self, path: str | Path) -> None:
        """Open the file beside its later place.

        Raises:
            RecordingError: the name does not end in .mcap, or the place cannot be written to.
        """
        self._file = TopicFile(path, growing=False)
        self._store = self._file.store
        self._channels: dict[str, Any] = {}

    def tensions(
        self, log_ns: int, stamp_ns: int, names: Sequence[str], efforts_n: Sequence[float]
    ) -> None:
        """One `cable_tensions`."""
        message = self._joint_state(stamp_ns, names, effort=efforts_n)
        self._write(topics.CABLE_TENSIONS, log_ns, message)

    def command(
        self, log_ns: int, stamp_ns: int, names: Sequence[str], angles_rad: Sequence[float]
    ) -> None:
        """One `joint_commands`."""
        message = self._joint_state(stamp_ns, names, position=angles_rad)
        self._write(topics.JOINT_COMMANDS, log_ns, message)

    def load(
        self, log_ns: int, stamp_ns: int, frame_id: str, force_n: Sequence[float],
        torque_n_m: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        """One `applied_wrench`; `force_n` (3,) in base axes."""
        vector = self._store.types["geometry_msgs/msg/Vector3"]
        wrench = self._store.types["geometry_msgs/msg/Wrench"]
        message = self._store.types[WRENCH](
            header=self._header(stamp_ns, frame_id),
            wrench=wrench(
                force=vector(*map(float, force_n)), torque=vector(*map(float, torque_n_m))
            ),
        )
        self._write(topics.APPLIED_WRENCH, log_ns, message)

    def trial(self, log_ns: int, number: int) -> None:
        """One `trial`."""
        self._write(topics.TRIAL, log_ns, self._store.types[NUMBER](data=int(number)))

    def close(self) -> None:
        """Finish the file and put it in its place.

        Raises:
            RecordingError: it cannot be written.
        """
        self._file.close()

    def discard(self) -> None:
        """Leave nothing behind."""
        self._file.discard()

    def _write(self, topic: str, log_ns: int, message: Any) -> None:
        kind = INPUTS[topic].kind
        if topic not in self._channels:
            self._channels[topic] = self._file.add(resolved(topic), kind, INPUTS[topic].offered)
        raw = bytes(self._store.serialize_cdr(message, kind))
        self._file.write(self._channels[topic], log_ns, raw)

    def _joint_state(self, stamp_ns: int, names: Sequence[str], **fields: Sequence[float]) -> Any:
        values = {name: np.asarray(value, dtype=np.float64) for name, value in fields.items()}
        empty = {name: np.empty(0) for name in ("position", "velocity", "effort")}
        return self._store.types[JOINT_STATE](
            header=self._header(stamp_ns, "base_link"), name=list(names), **(empty | values)
        )

    def _header(self, stamp_ns: int, frame_id: str) -> Any:
        sec, nanosec = divmod(int(stamp_ns), 1_000_000_000)
        stamp = self._store.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        return self._store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        else:
            self.discard()
