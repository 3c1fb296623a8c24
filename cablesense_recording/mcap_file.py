"""Recordings as rosbag2 MCAP: the contract's topics, read without a ROS installation.

Each `cable_tensions` is one row, with the command and the load in force when it came.
"""

from __future__ import annotations

import logging
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_base.files import plain_name
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Load, NamedOrder, cable_offsets_m, joint_command_rad
from cablesense_msgs_py.qos import INPUTS, RECORDED_TOPICS
from cablesense_msgs_py.serialized import require_bounded
from cablesense_msgs_py.topics import ContractError
from cablesense_recording.first_command import FirstCommand
from cablesense_recording.layout import Described, layout_of
from cablesense_recording.mcap_messages import (
    LEAST_BYTES,
    McapMessages,
    RawMessage,
    parsed_message,
)
from cablesense_recording.recording import (
    MAX_NUMBERS,
    Recording,
    RecordingError,
    derive_trials,
    given_places,
    one_clock,
)

MAX_FILE_BYTES = 2_000_000_000
"""An hour at 1 kHz."""

PACKED_ENDING = ".mcap.zstd"
"""Of a file that `ros2 bag record --compression-mode file` packed as a whole."""

TOPIC_OPTION = "--topic"
"""The option of `cablesense gap` that chooses among topics."""

_LOG = logging.getLogger(__name__)
_NO_LOAD = Load(0, np.zeros(3))
_LATEST_NS = 2**63 - 1
_PLACE_DECIMALS = 6
"""Those of a place in a CSV file."""


class BagRows:
    """The rows that messages make, taken in the order they came.

    With `keep` false messages are only checked against the contract.
    """

    def __init__(self, machine: Described, keep: bool = True) -> None:
        layout = layout_of(machine)
        self._layout = layout
        self._keep = keep
        self._cables = NamedOrder(layout.channel_names, "cables")
        self._joints = NamedOrder(layout.command_names, "joints")
        self._command: Array | None = None
        self._first_command = FirstCommand(layout.command_topic)
        self._loads: dict[int, Load] = {}
        self._trial = np.nan
        self._offset = False
        self._reading_count = 0
        numbers_in_row = 7 + len(layout.command_names) + len(layout.channel_names)
        self._most_rows = MAX_NUMBERS // numbers_in_row
        # plain arrays, as objects would take four times the memory
        self._times_ns = array("q")
        self._messages = array("q")
        self._numbers = array("d")

    def take(self, topic: str, log_ns: int, message: Any) -> None:
        """One message of the topics of a recording, `log_ns` when it came.

        Raises:
            ContractError: the message breaks the contract.
            RecordingError: tensions came while two segments were loaded.
        """
        layout = self._layout
        if topic == topics.CABLE_TENSIONS:
            self._reading_count += 1
            self._first_command.reading(log_ns)
        if topic == layout.command_topic:
            self._first_command.command(log_ns)
            self._command = joint_command_rad(
                message, self._joints, self._command, layout.largest_command
            )
        elif topic == topics.CABLE_OFFSETS:
            self._offset = bool(cable_offsets_m(message, self._cables).any())
        elif topic == topics.APPLIED_WRENCH:
            load = layout.load_of(message, self._command)
            self._loads.pop(load.segment, None)
            if load.force_base_n.any():
                self._loads[load.segment] = load
        elif topic == topics.TRIAL:
            self._trial = float(message.data)
        elif topic == topics.CABLE_TENSIONS and self._command is not None:
            self._take_tensions(log_ns, message, self._command)

    def recording(self, path: Path) -> Recording:
        """All rows, time from the first; `path` they came from.

        Raises:
            RecordingError: there are none.
        """
        command_topic = self._layout.command_topic
        if self._command is None:
            raise RecordingError(
                f"{path}: no message on {command_topic}; publish the command once more "
                "after the recorder has started, also for a straight arm"
            )
        if not self._times_ns:
            raise RecordingError(
                f"{path}: no message on {topics.CABLE_TENSIONS} after the first on "
                f"{command_topic}; record on after the command"
            )
        logs_ns, stamps_ns = np.array(self._times_ns).reshape(-1, 2).T
        clock = one_clock(path, logs_ns, stamps_ns)
        passed_ns = clock.time_ns - clock.time_ns[0]
        time_s: Array = passed_ns.astype(np.float64) * 1e-9
        numbers = np.array(self._numbers).reshape(len(time_s), -1)
        ends = np.cumsum([1, 1, 1, 3, len(self._layout.command_names)])
        trial, segment, place, load_n, command, tensions_n = np.split(numbers, ends, axis=1)
        at_m = given_places(np.round(place[:, 0], _PLACE_DECIMALS))
        segments = segment[:, 0].astype(np.int64)
        named = np.isfinite(trial[:, 0])
        if named.any():
            trials = np.where(named, trial[:, 0], trial[named][0, 0]).astype(np.int64)
        else:
            trials = derive_trials(time_s, command, segments, load_n, at_m)
        name = plain_name(path.stem)
        return Recording(
            name=name,
            time_s=time_s,
            trial=trials,
            command_rad=command,
            load_segment=segments,
            load_n=load_n,
            tensions_n=tensions_n,
            load_at_m=at_m,
            message=np.array(self._messages, dtype=np.int64),
            notes=(*clock.notes, *self._first_command.notes),
            commanded_inside=self._first_command.comes_inside,
        )

    def _take_tensions(self, log_ns: int, message: Any, command: Array) -> None:
        if len(self._loads) > 1:
            raise RecordingError(
                f"segments {' and '.join(map(str, sorted(self._loads)))} are loaded at once; take "
                "one load off (a zero force in its frame) before putting on the next"
            )
        load = next(iter(self._loads.values()), _NO_LOAD)
        place_m = np.nan if load.contact_m is None else load.contact_m
        tensions = self._cables.pick(message.name, message.effort, "effort")
        if not self._keep or self._offset:
            return
        if len(self._times_ns) >= 2 * self._most_rows:
            raise RecordingError(
                f"more than {self._most_rows} samples; an hour at 1 kHz has fewer: split it"
            )
        stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        self._times_ns.extend((min(log_ns, _LATEST_NS), stamp_ns))
        self._messages.append(self._reading_count)
        labels = self._trial, load.segment, place_m
        for numbers in (labels, load.force_base_n, command, tensions):
            self._numbers.extend(numbers)


def read_mcap(path: str | Path, machine: Described, topics: Sequence[str] = ()) -> Recording:
    """Read a .mcap file, or a rosbag2 folder with its metadata.yaml.

    One row per `cable_tensions`; command and load are the latest that came before it, where joints
    are measured their positions in place of commands. Rows before the first are left out: their
    pose is unknown; so are those with offset cables, which no simulator here knows. Without the
    topic `trial`, trials are derived (`recording.derive_trials`). Of several machines that is read
    whose `topics` are given, one or more of them by their full names.

    Raises:
        RecordingError: no bag, a topic missing, twice or of another type, a message that breaks
            the contract, loads on two segments at once.
    """
    path = Path(path)
    rows = BagRows(machine)
    command_topic = layout_of(machine).command_topic
    taken = Counter[str]()
    full_topics: dict[str, str] = {}
    for topic, log_ns, message in _messages(path, command_topic, topics, full_topics):
        taken[topic] += 1
        try:
            rows.take(topic, log_ns, message)
        except CableSenseError as error:
            raise RecordingError(f"{path}: {topic}, message {taken[topic]}: {error}") from error
    recording = rows.recording(path)
    note = f"Topics are {', '.join(sorted(full_topics.values()))}."
    return replace(recording, notes=(note, *recording.notes))


def is_bag(path: Path) -> bool:
    """Whether `read_mcap` reads a path: a .mcap file, or a folder of `ros2 bag`.

    A recorder that was killed leaves a folder without its metadata.
    """
    if path.is_dir():
        inside = (path / "metadata.yaml").is_file() or any(path.glob("*.mcap"))
        return inside or any(path.glob("*.db3")) or any(path.glob(f"*{PACKED_ENDING}"))
    return path.name.lower().endswith((".mcap", PACKED_ENDING))


def _messages(
    path: Path, command_topic: str, chosen_topics: Sequence[str], full_topics: dict[str, str]
) -> Iterator[tuple[str, int, Any]]:
    """Topic, time in ns and content of a machine's messages, in the order they came.

    Of several machines the messages are those in the namespaces of `chosen_topics`. `full_topics`
    is filled with the full name of each topic that is read.
    """
    spaces = {topic.rpartition("/")[0] for topic in chosen_topics}
    inputs = {**INPUTS, command_topic: RECORDED_TOPICS[command_topic]}
    others: set[str] = set()

    def wanted(raw: RawMessage) -> bool:
        topic = raw.topic.rpartition("/")[2]
        if topic not in inputs or (spaces and raw.topic.rpartition("/")[0] not in spaces):
            others.add(raw.topic)
            return False
        first = full_topics.setdefault(topic, raw.topic)
        if raw.topic != first:  # `/arm/cable_tensions` is `cable_tensions` while there is one
            named = " and ".join(sorted((raw.topic, first)))
            raise RecordingError(
                f"{path}: {named} are both {topic}; record one arm alone, or choose one, as with "
                f"{TOPIC_OPTION} {min(raw.topic, first)}"
            )
        if raw.kind != inputs[topic].kind:
            raise RecordingError(
                f"{path}: {raw.topic} is of type {raw.kind[:80]!r}; it must be "
                f"{inputs[topic].kind}"
            )
        return True

    for raw, message in decoded(path, wanted):
        yield raw.topic.rpartition("/")[2], raw.log_ns, message
    needed = (topics.CABLE_TENSIONS, command_topic)
    missing = [topic for topic in needed if topic not in full_topics]
    if missing:
        present = ", ".join(sorted({*others, *full_topics.values()})[:8]) or "nothing"
        raise RecordingError(
            f"{path}: misses {' and '.join(missing)}, and has {present}; record with: cablesense "
            "gap record --arm ARM --out FILE"
        )


def decoded(path: Path, wanted: Callable[[RawMessage], bool]) -> Iterator[tuple[RawMessage, Any]]:
    """The wanted messages of a .mcap file or rosbag2 folder with their content, in file order.

    Raises:
        RecordingError: as `raw_messages`; a message over the contract's size, or not of its type.
    """
    try:
        for raw in raw_messages(path):
            if not wanted(raw):
                continue
            try:
                require_bounded(raw.data)
            except ContractError as error:
                raise RecordingError(f"{path}: {raw.topic}: {error}") from error
            yield raw, parsed_message(raw)
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
    _refuse_packed(path)
    inside = sorted(path.glob("*.mcap"), key=lambda file: (len(file.name), file.name))
    for file in inside if path.is_dir() else [path]:
        if path.is_dir() and file.stat().st_size < LEAST_BYTES:
            _LOG.warning("%s: breaks off at its begin; what came before is used", file)
            continue
        messages = McapMessages(file)
        yield from messages
        if messages.cut:
            _LOG.warning("%s: %s; what came before is used", file, messages.cut)
    if inside or not path.is_dir():
        return
    if not (path / "metadata.yaml").is_file():
        raise RecordingError(
            f"{path}: has no metadata.yaml, as its recorder was killed; make it with: ros2 bag "
            "reindex"
        )
    from rosbags.rosbag2 import Reader

    with Reader(path) as reader:
        for connection, log_ns, data in reader.messages():
            yield RawMessage(connection.topic, connection.msgtype, log_ns, data)


def _refuse_packed(path: Path) -> None:
    """Files that are packed as a whole; of a whole folder `rosbags` unpacks them."""
    single = [path] if path.name.lower().endswith(PACKED_ENDING) else []
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        single = sorted(path.glob(f"*{PACKED_ENDING}"))
    if single:
        raise RecordingError(
            f"{single[0]}: is packed as a whole; unpack it first: zstd -d {single[0].name}"
        )
