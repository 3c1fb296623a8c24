"""Writes the contract's topics to one rosbag2 MCAP file, without a ROS installation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from cablesense_gap.recordings.topic_file import TopicFile
from cablesense_msgs_py import topics
from cablesense_msgs_py.topic_types import INPUTS, JOINT_STATE, NUMBER, WRENCH, resolved


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
