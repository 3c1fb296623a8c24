"""Recordings as rosbag2 MCAP: the contract's topics, read and written without a ROS installation.

Each `cable_tensions` is one row, with the command and the load in force when it came.
"""

from __future__ import annotations

import logging
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_gap.recordings.mcap_messages import BagTypes, McapMessages, RawMessage, TopicFile
from cablesense_gap.recordings.recording import (
    MAX_NUMBERS,
    Recording,
    RecordingError,
    derive_trials,
    numbers_a_row,
)
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import NamedOrder, cable_offsets_m, joint_command_rad, read_load
from cablesense_msgs_py.qos import INPUTS, JOINT_STATE_TYPE, NUMBER_TYPE, WRENCH_TYPE, resolved
from cablesense_msgs_py.serialized import require_bounded
from cablesense_msgs_py.topics import ContractError, Frames
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.kinematics import contact_points_m

MAX_FILE_BYTES = 2_000_000_000
"""An hour at 1 kHz."""

_LOG = logging.getLogger(__name__)
_REQUIRED = (topics.CABLE_TENSIONS, topics.JOINT_COMMANDS)
_NO_LOAD = np.zeros(3)
_LATEST_NS = 2**63 - 1
_START_NS = 1_000_000_000
"""Stamp of a written recording's time 0: a stamp of 0 would mean that there is none."""


class BagRows:
    """The rows that messages make, taken in the order they came.

    With `keep` false messages are only checked against the contract.
    """

    def __init__(self, arm: Arm, keep: bool = True) -> None:
        self._arm = arm
        self._keep = keep
        self._cables = NamedOrder(arm.cable_names, "cables")
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._taken: Counter[str] = Counter()
        self._command: Array | None = None
        self._loads: dict[int, Array] = {}
        self._trial = np.nan
        self._offset = False
        self._most_rows = MAX_NUMBERS // numbers_a_row(arm.joint_count, arm.cable_count)
        # plain arrays, as objects would take four times the memory
        self._times_ns, self._numbers = array("q"), array("d")

    def taken(self, topic: str) -> int:
        """How many messages of a topic have come, the last one included."""
        return self._taken[topic]

    def take(self, topic: str, log_ns: int, message: Any) -> None:
        """One message of the topics of a recording, `log_ns` when it came.

        Raises:
            ContractError: the message breaks the contract.
            RecordingError: tensions came while two segments were loaded.
        """
        self._taken[topic] += 1
        if topic == topics.JOINT_COMMANDS:
            self._command = joint_command_rad(message, self._joints, self._command)
        elif topic == topics.CABLE_OFFSETS:
            self._offset = bool(cable_offsets_m(message, self._cables).any())
        elif topic == topics.APPLIED_WRENCH:
            self._take_load(message)
        elif topic == topics.TRIAL:
            self._trial = float(message.data)
        elif self._command is not None:
            self._take_tensions(log_ns, message, self._command)

    def recording(self, path: Path) -> Recording:
        """All rows, time from the first; `path` they came from.

        Raises:
            RecordingError: there are none.
        """
        if self._command is None:
            raise RecordingError(
                f"{path}: no message on {topics.JOINT_COMMANDS}; publish the command once more "
                "after the recorder has started, also for a straight arm"
            )
        if not self._times_ns:
            raise RecordingError(
                f"{path}: no message on {topics.CABLE_TENSIONS} after the first on "
                f"{topics.JOINT_COMMANDS}; record on after the command"
            )
        logs_ns, stamps_ns = np.array(self._times_ns).reshape(-1, 2).T
        # a clock that stamps only some messages is none
        clock_ns = stamps_ns if stamps_ns.all() else logs_ns
        time_s: Array = (clock_ns - clock_ns[0]).astype(np.float64) * 1e-9
        numbers = np.array(self._numbers).reshape(len(time_s), -1)
        ends = np.cumsum([1, 1, 3, self._arm.joint_count])
        trial, segment, load_n, command, tensions_n = np.split(numbers, ends, axis=1)
        segments, named = segment[:, 0].astype(np.int64), np.isfinite(trial[:, 0])
        if named.any():
            trials = np.where(named, trial[:, 0], trial[named][0, 0]).astype(np.int64)
        else:
            trials = derive_trials(time_s, command, segments, load_n)
        return Recording(path.stem, time_s, trials, command, segments, load_n, tensions_n)

    def _take_load(self, message: Any) -> None:
        name = message.header.frame_id
        prefix = name.removesuffix("base_link")
        if prefix == name:
            prefix = name.rpartition("segment_")[0]
        load = read_load(message, Frames(self._arm.segment_count, prefix), self._contacts_m)
        self._loads.pop(load.segment, None)
        if load.force_base_n.any():
            self._loads[load.segment] = load.force_base_n

    def _contacts_m(self) -> Array:
        """(N, 3) at the present command."""
        command = np.zeros(self._arm.joint_count) if self._command is None else self._command
        return np.asarray(contact_points_m(mechanism_of(self._arm), command))

    def _take_tensions(self, log_ns: int, message: Any, command: Array) -> None:
        if len(self._loads) > 1:
            raise RecordingError(
                f"segments {' and '.join(map(str, sorted(self._loads)))} are loaded at once; take "
                "one load off (a zero force in its frame) before putting on the next"
            )
        segment, force = next(iter(self._loads.items()), (0, _NO_LOAD))
        tensions = self._cables.pick(message.name, message.effort, "effort")
        if not self._keep or self._offset:
            return
        if len(self._times_ns) >= 2 * self._most_rows:
            raise RecordingError(
                f"more than {self._most_rows} samples; an hour at 1 kHz has fewer: split it"
            )
        stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        self._times_ns.extend((min(log_ns, _LATEST_NS), stamp_ns))
        for numbers in ((self._trial, segment), force, command, tensions):
            self._numbers.extend(numbers)


def read_mcap(path: str | Path, arm: Arm) -> Recording:
    """Read a .mcap file, or a rosbag2 folder with its metadata.yaml.

    One row per `cable_tensions`; command and load are the latest that came before it. Rows before
    the first command are left out: their pose is unknown; so are those with offset cables, which
    no simulator here knows. Without the topic `trial`, trials are derived
    (`recording.derive_trials`).

    Raises:
        RecordingError: no bag, a topic missing, twice or of another type, a message that breaks
            the contract, loads on two segments at once.
    """
    path = Path(path)
    rows = BagRows(arm)
    for topic, log_ns, message in _messages(path):
        try:
            rows.take(topic, log_ns, message)
        except CableSenseError as error:
            raise RecordingError(
                f"{path}: {topic}, message {rows.taken(topic)}: {error}"
            ) from error
    return rows.recording(path)


def write_mcap(path: str | Path, recording: Recording, arm: Arm) -> None:
    """Write a recording as the topics of a running arm, messages only where something changes.

    Raises:
        RecordingError: not named .mcap, or the place cannot be written to.
    """
    with BagWriter(path) as bag:
        last = 0
        for row in range(len(recording)):
            now_ns = _START_NS + round((recording.time_s[row] - recording.time_s[0]) * 1e9)
            now, first = (now_ns, now_ns), row == 0
            if first or recording.trial[row] != recording.trial[row - 1]:
                bag.trial(now_ns, int(recording.trial[row]))
            command = recording.command_rad[row]
            if first or (command != recording.command_rad[row - 1]).any():
                bag.joint_state(topics.JOINT_COMMANDS, *now, arm.joint_names, position=command)
            segment, load = int(recording.load_segment[row]), recording.load_n[row]
            if last and segment != last:
                bag.load(*now, f"segment_{last}", (0.0, 0.0, 0.0))
            if segment and (segment != last or (load != recording.load_n[row - 1]).any()):
                bag.load(*now, f"segment_{segment}", load.tolist())
            last = segment
            tensions_n = recording.tensions_n[row]
            bag.joint_state(topics.CABLE_TENSIONS, *now, arm.cable_names, effort=tensions_n)


def is_bag(path: Path) -> bool:
    """Whether `read_mcap` reads a path, by its ending or its metadata."""
    return path.suffix.lower() == ".mcap" or (path / "metadata.yaml").is_file()


def _messages(path: Path) -> Iterator[tuple[str, int, Any]]:
    """Topic, time in ns and content of an arm's messages, in the order they came."""
    found: dict[str, str] = {}
    others: set[str] = set()

    def wanted(raw: RawMessage) -> bool:
        topic = raw.topic.rpartition("/")[2]
        if topic not in INPUTS:
            others.add(raw.topic)
            return False
        first = found.setdefault(topic, raw.topic)
        if raw.topic != first:  # `/arm/cable_tensions` is `cable_tensions` while there is one
            named = " and ".join(sorted((raw.topic, first)))
            raise RecordingError(f"{path}: {named} are both {topic}; record one arm alone")
        if raw.kind != INPUTS[topic].kind:
            raise RecordingError(
                f"{path}: {raw.topic} is of type {raw.kind[:80]!r}; it must be "
                f"{INPUTS[topic].kind}"
            )
        return True

    for raw, message in decoded(path, wanted):
        yield raw.topic.rpartition("/")[2], raw.log_ns, message
    missing = [topic for topic in _REQUIRED if topic not in found]
    if missing:
        there = ", ".join(sorted({*others, *found.values()})[:8]) or "nothing"
        raise RecordingError(
            f"{path}: misses {' and '.join(missing)}, and has {there}; record with: cablesense "
            "gap record"
        )


def decoded(path: Path, wanted: Callable[[RawMessage], bool]) -> Iterator[tuple[RawMessage, Any]]:
    """The wanted messages of a .mcap file or rosbag2 folder with their content, in file order.

    Raises:
        RecordingError: as `raw_messages`; a message over the contract's size, or not of its type.
    """
    types = BagTypes()
    try:
        for raw in raw_messages(path):
            if not wanted(raw):
                continue
            try:
                require_bounded(raw.data)
            except ContractError as error:
                raise RecordingError(f"{path}: {raw.topic}: {error}") from error
            yield raw, types.message(raw.kind, raw.data)
    except CableSenseError:
        raise
    except Exception as error:  # a broken file raises anything in a parser: struct, zstd, keys …
        line = " ".join(str(error).split())[:200] or type(error).__name__
        raise RecordingError(
            f"{path}: cannot be read as rosbag2 MCAP ({line}); `ros2 bag info` should know it"
        ) from error


def raw_messages(path: Path) -> Iterator[RawMessage]:
    """Messages of a file, even an incomplete one, or of a folder's files in their order.

    A folder without MCAP files is left to `rosbags`, which unpacks without bound.

    Raises:
        RecordingError: no such file, over `MAX_FILE_BYTES`, no MCAP, or damaged before its end.
    """
    if not path.exists():
        raise RecordingError(f"{path}: no such file")
    size = sum(file.stat().st_size for file in (path.iterdir() if path.is_dir() else [path]))
    if size > MAX_FILE_BYTES:
        raise RecordingError(
            f"{path}: {size / 1e9:.1f} GB; a recording has at most {MAX_FILE_BYTES / 1e9:g} GB: "
            "record the needed topics alone"
        )
    inside = sorted(path.glob("*.mcap"), key=lambda file: (len(file.name), file.name))
    for file in inside if path.is_dir() else [path]:
        messages = McapMessages(file)
        yield from messages
        if messages.cut:
            _LOG.warning("%s: %s; what came before is used", file, messages.cut)
    if inside or not path.is_dir():
        return
    from rosbags.rosbag2 import Reader

    with Reader(path) as reader:
        for connection, log_ns, data in reader.messages():
            yield RawMessage(connection.topic, connection.msgtype, log_ns, data)


class BagWriter(TopicFile):
    """A recording's topics as one .mcap file; it appears under its name when it is closed, whole.

    Times are in ns: `log_ns` when a message came, `stamp_ns` of its header, 0 for none. A topic is
    in the file once a message of it is written.
    """

    def __init__(self, path: str | Path) -> None:
        """As `TopicFile`."""
        super().__init__(path, growing=False)
        self._channels: dict[str, Any] = {}

    def joint_state(
        self, topic: str, log_ns: int, stamp_ns: int, names: Sequence[str],
        **fields: Sequence[float],
    ) -> None:  # fmt: skip
        """One `cable_tensions` (`effort`, N) or `joint_commands` (`position`, rad)."""
        values = {name: np.asarray(value, dtype=np.float64) for name, value in fields.items()}
        empty = {name: np.empty(0) for name in ("position", "velocity", "effort")}
        message = self.store.types[JOINT_STATE_TYPE](
            header=self._header(stamp_ns, "base_link"), name=list(names), **(empty | values)
        )
        self._put(topic, log_ns, message)

    def load(
        self, log_ns: int, stamp_ns: int, frame_id: str, force_n: Sequence[float],
        torque_n_m: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        """One `applied_wrench`; `force_n` (3,) in base axes."""
        types = self.store.types
        vector = types["geometry_msgs/msg/Vector3"]
        force, torque = vector(*map(float, force_n)), vector(*map(float, torque_n_m))
        wrench = types["geometry_msgs/msg/Wrench"](force=force, torque=torque)
        message = types[WRENCH_TYPE](header=self._header(stamp_ns, frame_id), wrench=wrench)
        self._put(topics.APPLIED_WRENCH, log_ns, message)

    def trial(self, log_ns: int, number: int) -> None:
        """One `trial`."""
        self._put(topics.TRIAL, log_ns, self.store.types[NUMBER_TYPE](data=int(number)))

    def _put(self, topic: str, log_ns: int, message: Any) -> None:
        kind = INPUTS[topic].kind
        if topic not in self._channels:
            self._channels[topic] = self.add(resolved(topic), kind, INPUTS[topic].offered)
        self.write(self._channels[topic], log_ns, bytes(self.store.serialize_cdr(message, kind)))

    def _header(self, stamp_ns: int, frame_id: str) -> Any:
        sec, nanosec = divmod(int(stamp_ns), 1_000_000_000)
        stamp = self.store.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        return self.store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)
