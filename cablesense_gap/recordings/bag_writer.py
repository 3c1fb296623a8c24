"""Writes the contract's topics to one rosbag2 MCAP file, without a ROS installation."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np

from cablesense_gap.recordings.recording_error import RecordingError
from cablesense_msgs_py import topics

JOINT_STATE = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"
NUMBER = "std_msgs/msg/Int32"

TYPES = {
    topics.CABLE_TENSIONS: JOINT_STATE,
    topics.JOINT_COMMANDS: JOINT_STATE,
    topics.APPLIED_WRENCH: WRENCH,
    topics.TRIAL: NUMBER,
}
"""What a recording holds, by topic."""

_BAG_VERSION: Final = 9
"""That of ROS 2 Jazzy."""


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
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        self._path = Path(path)
        if self._path.suffix != ".mcap":
            raise RecordingError(f"{self._path}: a recording of topics must be named ….mcap")
        if self._path.is_dir():
            raise RecordingError(f"{self._path}: is a folder; give the name of a file")
        self._beside = self._path.parent / f".{self._path.name}.{os.getpid()}.part"
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._writer = Writer(
            self._beside, version=_BAG_VERSION, storage_plugin=StoragePlugin.MCAP
        )
        self._connections: dict[str, Any] = {}
        if not self._path.parent.is_dir():
            raise RecordingError(f"{self._path}: there is no folder {self._path.parent}")
        try:
            self._writer.open()
        except OSError as error:
            raise RecordingError(
                f"{self._path}: cannot be written ({error.strerror or error})"
            ) from error

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
        try:
            self._writer.close()
            (self._beside / f"{self._beside.name}.mcap").replace(self._path)
        except OSError as error:
            raise RecordingError(
                f"{self._path}: cannot be written ({error.strerror or error})"
            ) from error
        finally:
            self.discard()

    def discard(self) -> None:
        """Leave nothing behind but a file that is closed already."""
        with suppress(Exception):
            self._writer.abort()
        shutil.rmtree(self._beside, ignore_errors=True)

    def _write(self, topic: str, log_ns: int, message: Any) -> None:
        kind = TYPES[topic]
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                f"/{topic}", kind, typestore=self._store
            )
        self._writer.write(
            self._connections[topic], log_ns, self._store.serialize_cdr(message, kind)
        )

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
