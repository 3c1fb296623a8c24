"""The joint states of a robot in a bag, as the columns that a CSV file of it has.

A topic is read as sources: messages that name the same joints come from one. A source that has all
joints gives the rows. Joints that come from several are brought to the times of the slowest. What
would be a guess is refused: two topics, or two sources, that give the same joint. Where no joint
states have all joints, poses of tracked frames give the rows, with the efforts of their times.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, some_of
from cablesense_msgs_py.qos import JOINT_STATE_TYPE, NUMBER_TYPE
from cablesense_recording.channels import TIME, TRIAL, Kind, RobotChannels, composed, pose_labels
from cablesense_recording.mcap_file import TOPIC_OPTION, decoded
from cablesense_recording.mcap_messages import CountedMessages, RawMessage
from cablesense_recording.pose_messages import POSE_TYPES, FramePoses, frame_poses
from cablesense_recording.recording import MAX_NUMBERS, RecordingError, one_clock

_NUMBERS_TYPE = "std_msgs/msg/Float64MultiArray"
_COMMAND = "command"
_LATEST_NS = 2**63 - 1
_HELD_INTERVALS = 5.0
_OTHER_CLOCK_S = 0.1
"""Sources whose clocks differ by more are not stamped by one."""


@dataclass
class _Source(CountedMessages):
    """Messages of one topic that name the same joints, in the order they came.

    Attributes:
        topic: full name.
        names: as its messages name the joints, those of other machines too.
        joints: numbers of the robot's joints among them.
        places: where these stand in a message.
        has_efforts: whether its messages have efforts.
        numbers: positions, then efforts, of `joints` by message.
    """

    topic: str
    names: tuple[str, ...]
    joints: tuple[int, ...]
    places: tuple[int, ...]
    has_efforts: bool

    def __len__(self) -> int:
        return len(self.counts) // 3

    @property
    def values(self) -> Array:
        """(R, 2, K) positions and efforts of its joints."""
        return np.array(self.numbers).reshape(-1, 2, len(self.joints))


@dataclass
class _Series:
    """Numbers of one topic, each of which holds until the next: commands, or a trial's number.

    Attributes:
        counts: which message of the bag each came with, counted over all topics from 1.
        numbers: of one message after the other, as many each.
    """

    counts: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))

    def add(self, count: int, values: Iterable[float]) -> None:
        self.counts.append(count)
        self.numbers.extend(values)

    def at(self, counts: NDArray[np.int64], width: int) -> Array:
        """(R, width) the latest before each count; NaN before the first."""
        values = np.array(self.numbers).reshape(-1, width)
        latest = np.searchsorted(np.array(self.counts, dtype=np.int64), counts) - 1
        return np.where(latest[:, None] >= 0, values[np.maximum(latest, 0)], np.nan)


class _Bag:
    """What a bag holds of a robot, by topic."""

    def __init__(self, path: Path, channels: RobotChannels, topics: Sequence[str]) -> None:
        self.path = path
        self.channels = channels
        self.topics = topics
        self.sources: dict[tuple[str, tuple[str, ...], bool], _Source] = {}
        self.commands: dict[str, _Series] = {}
        self.trials: dict[str, _Series] = {}
        self.named: dict[str, set[str]] = {}
        self.of_commands: set[str] = set()
        self.ignored: dict[str, str] = {}
        self.efforts: dict[tuple[str, tuple[str, ...]], _Source] = {}
        self.pose_counts = array("q")
        self._command: dict[str, Array] = {}
        self._messages = Counter[str]()
        self._count = 0
        self._number_count = 0

    def take(self, raw: RawMessage, message: Any) -> None:
        """One message."""
        self._count += 1
        self._messages[raw.topic] += 1
        before = self._number_count
        if not hasattr(message, "data"):
            self._take_joint_state(raw, message)
        elif raw.topic.rpartition("/")[2] == TRIAL and np.ndim(message.data) == 0:
            self._add(self.trials, raw.topic, [float(message.data)])
        elif _COMMAND in raw.topic and np.shape(message.data) == (len(self.channels.actuators),):
            self._add(self.commands, raw.topic, np.asarray(message.data, dtype=float).tolist())
        if self._number_count > MAX_NUMBERS >= before:
            raise RecordingError(f"{self.path}: more than {MAX_NUMBERS} numbers; split it")

    def _add(self, series: dict[str, _Series], topic: str, values: Sequence[float]) -> None:
        series.setdefault(topic, _Series()).add(self._count, values)
        self._number_count += 1 + len(values)

    def _take_joint_state(self, raw: RawMessage, message: Any) -> None:
        names = tuple(composed(str(name)) for name in message.name)
        self.named.setdefault(raw.topic, set()).update(names)
        commands = self._are_commands(raw.topic, names)
        numbers = self.channels.joint_numbers
        if commands:
            self.of_commands.add(raw.topic)
            numbers = self.channels.actuator_numbers
        known = {place: numbers[name] for place, name in enumerate(names) if name in numbers}
        twice = [name for name, count in Counter(names).items() if count > 1 and name in numbers]
        if twice:
            raise self._wrong_message(
                raw.topic, f"name: {some_of(twice)} stands twice; each name must be there once"
            )
        if not known:
            return
        if commands:
            self._take_command(raw, message, names, known)
            return
        position = message.position
        effort = message.effort
        for what, values in (("position", position), ("effort", effort)):
            if len(values) not in (0, len(names)):
                raise self._wrong_message(
                    raw.topic,
                    f"{what} holds {len(values)} values for {len(names)} names; one for each "
                    "name is right",
                )
        if len(position) == 0:
            self.ignored[raw.topic] = "has no positions"
            if len(effort) == 0:
                return
        as_named = _Source(raw.topic, names, tuple(known.values()), tuple(known), len(effort) > 0)
        if len(position):
            source = self.sources.setdefault((raw.topic, names, len(effort) > 0), as_named)
        else:
            source = self.efforts.setdefault((raw.topic, names), as_named)
        stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        source.counts.extend((self._count, min(raw.log_ns, _LATEST_NS), stamp_ns))
        places = list(source.places)
        positions = position[places] if len(position) else np.full(len(known), np.nan)
        source.numbers.extend(positions.tolist())
        efforts = effort[places] if len(effort) else np.full(len(known), np.nan)
        source.numbers.extend(efforts.tolist())
        self._number_count += 3 + 2 * len(known)

    def wanted(self, raw: RawMessage) -> bool:
        """Whether a message is to be taken; poses are counted, and read where they are needed."""
        if raw.kind in POSE_TYPES:
            self.pose_counts.append(self._count + 1)
        return raw.kind in (JOINT_STATE_TYPE, NUMBER_TYPE, _NUMBERS_TYPE)

    def _are_commands(self, topic: str, names: tuple[str, ...]) -> bool:
        """Whether joint states are commands: by the topic's own name, or by their names too.

        A topic that was asked for and names joints alone has states, whatever its name.
        """
        of_actuators = any(name in self.channels.actuator_numbers for name in names)
        of_joints = any(name in self.channels.joint_numbers for name in names)
        if _COMMAND in topic.rpartition("/")[2]:
            return of_actuators or not (of_joints and topic in self.topics)
        return _COMMAND in topic and of_actuators and not of_joints

    def _take_command(
        self, raw: RawMessage, message: Any, names: tuple[str, ...], known: dict[int, int]
    ) -> None:
        """The commands of the actuators that are named; the others hold."""
        commanded = message.effort if len(message.effort) else message.position
        if len(commanded) != len(names):
            raise self._wrong_message(
                raw.topic, f"has {len(commanded)} values for {len(names)} names; one each is right"
            )
        held = self._command.setdefault(raw.topic, np.full(len(self.channels.actuators), np.nan))
        held[list(known.values())] = commanded[list(known)]
        self._add(self.commands, raw.topic, held.tolist())

    def _wrong_message(self, topic: str, why: str) -> RecordingError:
        return RecordingError(f"{self.path}: {topic}, message {self._messages[topic]}: {why}")


def bag_table(
    path: Path, channels: RobotChannels, topics: Sequence[str] = ()
) -> tuple[dict[str, Array], list[str]]:
    """Columns of a recording as a CSV has them, one row per state, and sentences about them.

    Positions and efforts come from the joint states of one topic, or of several that have a part
    of the joints each. Commands come from a topic with `command` in its name, whose joint states
    name the actuators, or whose numbers are as many as these: the latest before each row. Trials
    come from a topic `trial`; rows before the first number are a separate trial. `topics` are
    those to read where several fit.

    Raises:
        RecordingError: no bag, one too large, no joint states with all joints, several topics
            that fit, several publishers on one, a joint that stands twice in a message.
    """
    bag = _Bag(path, channels, topics)
    for raw, message in decoded(path, bag.wanted):
        bag.take(raw, message)
    tracked = _tracked(bag, topics)
    _refuse_absent(bag, topics, tracked)
    if tracked:
        states_topic = tracked[0].topic
        counts, clock_ns, table, notes = _of_poses(bag, tracked)
    else:
        sources = _chosen_sources(bag, topics)
        states_topic = _topics_of(sources)[0]
        notes = [f"Joint states are those of {' and '.join(_topics_of(sources))}."]
        parts = _one_by_joint(bag, sources)
        counts, clock_ns, position, torque, clock_notes = _merged(path, parts, channels)
        notes += clock_notes
        table = dict(zip(channels.labels(Kind.POSITION), position.T, strict=True))
        table |= zip(channels.labels(Kind.TORQUE), torque.T, strict=True)
    table[TIME] = (clock_ns - clock_ns[0]).astype(np.float64) * 1e-9
    trial_topic = _chosen_topic(bag, "trials", list(bag.trials), topics, states_topic)
    if trial_topic:
        trial = bag.trials[trial_topic].at(counts, 1)[:, 0]
        numbered = np.isfinite(trial)
        if numbered.any():
            table[TRIAL] = np.where(numbered, trial, np.nanmin(trial) - 1.0)
    command_topic = _chosen_topic(bag, "commands", list(bag.commands), topics, states_topic)
    if command_topic:
        command = bag.commands[command_topic].at(counts, len(channels.actuators))
        table |= zip(channels.labels(Kind.COMMAND), command.T, strict=True)
        notes.append(f"Commands are those of {command_topic}.")
    elif bag.of_commands:
        notes.append(
            f"{some_of(sorted(bag.of_commands))} names none of the inputs "
            f"{some_of(channels.actuators) or '(the model has none)'}, so no commands are read."
        )
    return table, notes


def _tracked(bag: _Bag, topics: Sequence[str]) -> list[FramePoses]:
    """Poses of frames, where the joint states lack a joint; the one with fewest rows first."""
    covered = {joint for source in bag.sources.values() for joint in source.joints}
    if not bag.pose_counts or len(covered) == len(bag.channels.joints):
        return []
    poses_by_frame = frame_poses(bag.path, bag.channels.frames, topics, bag.pose_counts)
    return sorted(poses_by_frame, key=lambda each: len(each.counts))


def _of_poses(
    bag: _Bag, tracked: Sequence[FramePoses]
) -> tuple[NDArray[np.int64], NDArray[np.int64], dict[str, Array], list[str]]:
    """Counts and times (R,), ns, of the slowest frame's poses, all columns, and sentences.

    Other poses, and the positions and efforts that joint states have, are brought to these times.

    Raises:
        RecordingError: stamps run back, or two topics give the same joint.
    """
    slowest = tracked[0]
    labels_of_joints = bag.channels.labels(Kind.POSITION), bag.channels.labels(Kind.TORQUE)
    series: list[tuple[str, NDArray[np.int64], list[str], Array]] = []
    for each in tracked:
        series.append((each.topic, each.counts_and_times, pose_labels(each.frame), each.poses))
    for source in (*bag.sources.values(), *bag.efforts.values()):
        labels = [names[joint] for names in labels_of_joints for joint in source.joints]
        values = source.values.reshape(len(source), -1)
        finite = np.flatnonzero(np.isfinite(values).any(axis=0)).tolist()
        kept_labels = [labels[number] for number in finite]
        series.append((source.topic, source.counts_and_times, kept_labels, values[:, finite]))
    notes = [
        f"Poses of {each.frame} are those of {each.topic}, in the axes of "
        f"{each.parent or '(no name)'}, which must be those of the model's base."
        for each in tracked
    ]
    clock = one_clock(bag.path, *slowest.counts_and_times[:, 1:].T)
    clock_ns = clock.time_ns
    notes += clock.notes
    kept = np.ones(len(clock_ns), dtype=bool)
    columns: dict[str, Array] = {}
    for number, (topic, times, labels, values) in enumerate(series):
        twice = [label for label in labels if label in columns]
        if twice:
            raise RecordingError(
                f"{bag.path}: {topic} gives {some_of(twice)}, as another topic or publisher does; "
                "record one"
            )
        brought = values
        if number:
            topic_ns = one_clock(bag.path, *times[:, 1:].T).time_ns
            back = np.flatnonzero(np.diff(topic_ns) <= 0)
            if back.size:
                raise RecordingError(
                    f"{bag.path}: the stamps of {topic} stand still or run back in their message "
                    f"{back[0] + 2}; each must be later than the one before"
                )
            known, brought_values = _brought_to(clock_ns, topic_ns, values[:, None, :])
            brought = brought_values[:, 0]
            kept &= known
        columns |= zip(labels, brought.T, strict=True)
    if not kept.any():
        raise RecordingError(
            f"{bag.path}: poses of {slowest.frame} and the other topics have no time in common; "
            "stamp them by one clock"
        )
    counts = slowest.counts_and_times[:, 0]
    table = {label: values[kept] for label, values in columns.items()}
    return counts[kept], clock_ns[kept], table, notes


def _topics_of(sources: Sequence[_Source]) -> list[str]:
    return list(dict.fromkeys(source.topic for source in sources))


def _refuse_absent(bag: _Bag, topics: Sequence[str], tracked: Sequence[FramePoses]) -> None:
    present = {*bag.named, *bag.commands, *bag.trials, *(each.topic for each in tracked)}
    absent = [topic for topic in topics if topic not in present]
    if absent:
        raise RecordingError(
            f"{bag.path}: has no joint states, commands or trials on {some_of(absent)}; it has "
            f"{some_of(sorted(present)) or 'none'}"
        )


def _chosen_sources(bag: _Bag, topics: Sequence[str]) -> list[_Source]:
    """The sources of the topic that names all joints, or of those that together do.

    Raises:
        RecordingError: none do, or several do.
    """
    by_topic: dict[str, list[_Source]] = {}
    for source in bag.sources.values():
        by_topic.setdefault(source.topic, []).append(source)
    if any(topic in by_topic for topic in topics):
        by_topic = {
            topic: sources_there for topic, sources_there in by_topic.items() if topic in topics
        }
    everything = set(range(len(bag.channels.joints)))
    whole = [
        topic
        for topic, sources_there in by_topic.items()
        if everything <= {joint for source in sources_there for joint in source.joints}
    ]
    if len(whole) > 1:
        described = [f"{topic} ({_content(by_topic[topic])})" for topic in sorted(whole)]
        raise RecordingError(
            f"{bag.path}: {' and '.join(described)} name the joints "
            f"{some_of(bag.channels.joint_names)} each; choose one, as with {TOPIC_OPTION} "
            f"{sorted(whole)[0]}"
        )
    if whole:
        return by_topic[whole[0]]
    sources = [source for sources_there in by_topic.values() for source in sources_there]
    covered = {joint for source in sources for joint in source.joints}
    if everything <= covered:
        return _of_several_topics(bag, by_topic)
    raise RecordingError(_nothing_fits(bag, everything - covered))


def _content(sources: Sequence[_Source]) -> str:
    with_efforts = any(source.has_efforts for source in sources)
    return "positions and efforts" if with_efforts else "positions alone"


def _of_several_topics(bag: _Bag, by_topic: dict[str, list[_Source]]) -> list[_Source]:
    """Sources of topics that have a part of the joints each."""
    joints_of = {
        topic: {joint for source in sources_there for joint in source.joints}
        for topic, sources_there in by_topic.items()
    }
    for first, second in combinations(joints_of, 2):
        both = joints_of[first] & joints_of[second]
        if both:
            named = some_of([bag.channels.joint_names[joint] for joint in sorted(both)])
            raise RecordingError(
                f"{bag.path}: no topic has all joints, and {first} and {second} both have "
                f"{named}; choose the topics with {TOPIC_OPTION}"
            )
    return [source for sources_there in by_topic.values() for source in sources_there]


def _nothing_fits(bag: _Bag, missing: set[int]) -> str:
    wanted = bag.channels.joint_names
    states = {
        topic: messages for topic, messages in bag.named.items() if topic not in bag.of_commands
    }
    named = sorted({name for names in states.values() for name in names})
    text = (
        f"{bag.path}: holds no {JOINT_STATE_TYPE} with the joints {some_of(wanted)}; it names "
        f"{some_of(named) or 'none'}"
    )
    lacking = [wanted[joint] for joint in sorted(missing)]
    if len(lacking) < len(wanted):
        text += f", and lacks {some_of(lacking)}: to fix a joint, remove it from the model"
    without = [f"{topic} {why}" for topic, why in bag.ignored.items()]
    commands = sorted(bag.of_commands)
    if without:
        text += f"; {some_of(without)}"
    elif commands and not states:
        text += f"; {some_of(commands)} is taken for commands, unless {TOPIC_OPTION} names it"
    return text


def _one_by_joint(bag: _Bag, sources: Sequence[_Source]) -> list[list[_Source]]:
    """Sources that follow each other, as when efforts begin later; joints differ between these.

    Raises:
        RecordingError: two that give the same joint at the same time.
    """
    parts: list[list[_Source]] = []
    for source in sorted(sources, key=lambda each: each.counts[0]):
        for part in parts:
            if set(part[-1].joints) & set(source.joints):
                _refuse_interleaved(bag, part[-1], source)
                part.append(source)
                break
        else:
            parts.append([source])
    for part in parts:
        changed = {tuple(sorted(source.joints)) for source in part}
        if len(changed) > 1:
            least = min(part, key=lambda each: len(each.joints))
            raise RecordingError(
                f"{bag.path}: {least.topic} names {some_of(least.names)} in {len(least)} "
                "messages, and other joints in others; record while one set of drivers runs"
            )
    return parts


def _refuse_interleaved(bag: _Bag, first: _Source, second: _Source) -> None:
    if first.counts[-3] < second.counts[0]:
        return
    few, many = sorted((first, second), key=len)
    position = _message_number(bag, few)
    if few.has_efforts != many.has_efforts:
        without = few if many.has_efforts else many
        others = many if many.has_efforts else few
        position = _message_number(bag, without)
        what = (
            f"{len(without)} messages have no efforts, message {position} first, among "
            f"{len(others)} that have"
        )
    else:
        what = (
            f"{len(few)} messages name {some_of(few.names)}, message {position} first, among "
            f"{len(many)} that name {some_of(many.names)}"
        )
    raise RecordingError(
        f"{bag.path}: {few.topic}: {what}; a second publisher? Record the topic with one alone"
    )


def _message_number(bag: _Bag, source: _Source) -> int:
    """The number of its first message on the topic, from 1."""
    first = source.counts[0]
    others = [each for each in bag.sources.values() if each.topic == source.topic]
    return 1 + sum(int((each.counts_and_times[:, 0] < first).sum()) for each in others)


def _merged(
    path: Path, parts: Sequence[Sequence[_Source]], channels: RobotChannels
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array, list[str]]:
    """Counts and times (R,), ns, positions and torques (R, J) of all joints, and sentences.

    Raises:
        RecordingError: one of several series runs back.
    """
    series = [_concatenated(part) for part in parts]
    notes: list[str] = []
    logs = [times[:, 1] for times, _, _ in series]
    clocks = []
    for times, _, _ in series:
        clock = one_clock(path, times[:, 1], times[:, 2])
        clocks.append(clock.time_ns)
        notes += clock.notes
    if len(series) > 1:
        behind_s = [
            1e-9 * float(np.median(log_ns - clock_ns))
            for log_ns, clock_ns in zip(logs, clocks, strict=True)
        ]
        if np.ptp(behind_s) > _OTHER_CLOCK_S:
            clocks = logs
            notes.append("Stamps are of several clocks, so the times of arrival count.")
    slowest = min(range(len(series)), key=lambda number: len(clocks[number]))
    counts = series[slowest][0][:, 0]
    clock_ns = clocks[slowest]
    kept = np.ones(len(clock_ns), dtype=bool)
    position = np.full((len(clock_ns), len(channels.joints)), np.nan)
    torque = position.copy()
    for number, (_, joints, values) in enumerate(series):
        brought_values = values
        if number != slowest:
            back = np.flatnonzero(np.diff(clocks[number]) <= 0)
            if back.size:
                named = some_of([channels.joint_names[joint] for joint in joints])
                raise RecordingError(
                    f"{path}: the stamps of {named} stand still or run back in their message "
                    f"{back[0] + 2}; each must be later than the one before"
                )
            known, brought_values = _brought_to(clock_ns, clocks[number], values)
            kept &= known
        position[:, joints] = brought_values[:, 0]
        torque[:, joints] = brought_values[:, 1]
    if len(series) > 1:
        names = channels.joint_names
        groups = [some_of([names[joint] for joint in joints], 3) for _, joints, _ in series]
        notes.append(
            f"No message has all joints: {'; '.join(groups)} come in messages of their own and "
            f"are brought to the times of the slowest, {int(kept.sum())} rows."
        )
    return counts[kept], clock_ns[kept], position[kept], torque[kept], notes


def _concatenated(part: Sequence[_Source]) -> tuple[NDArray[np.int64], list[int], Array]:
    """Counts and times (R, 3), joints, and values (R, 2, K) of sources that follow each other."""
    joints = sorted(part[0].joints)
    ordered = [each.values[:, :, np.argsort(each.joints)] for each in part]
    times = np.concatenate([each.counts_and_times for each in part])
    return times, joints, np.concatenate(ordered)


def _brought_to(
    at_ns: NDArray[np.int64], clock_ns: NDArray[np.int64], values: Array
) -> tuple[NDArray[np.bool_], Array]:
    """Which times lie between close readings, and the readings (R, 2, K) straight on between."""
    if len(clock_ns) < 2:
        return np.zeros(len(at_ns), dtype=bool), np.repeat(values, len(at_ns), axis=0)
    usual_ns = float(np.median(np.diff(clock_ns)))
    after = np.clip(np.searchsorted(clock_ns, at_ns), 1, len(clock_ns) - 1)
    apart_ns = clock_ns[after] - clock_ns[after - 1]
    share = (at_ns - clock_ns[after - 1]) / apart_ns
    beyond = (share < -1.0) | (share > 2.0)
    known = (apart_ns <= _HELD_INTERVALS * usual_ns) & ~beyond
    share = np.clip(share, 0.0, 1.0)[:, None, None]
    return known, (1.0 - share) * values[after - 1] + share * values[after]


def _chosen_topic(
    bag: _Bag, what: str, present: list[str], topics: Sequence[str], states: str
) -> str | None:
    """The topic of commands or trials: the one that is asked for, of the namespace, or alone.

    Raises:
        RecordingError: several fit.
    """
    asked = [topic for topic in present if topic in topics]
    beside = [topic for topic in present if topic.rpartition("/")[0] == states.rpartition("/")[0]]
    chosen = asked or (beside if len(present) > 1 else present)
    if len(chosen) > 1 or (present and not chosen):
        raise RecordingError(
            f"{bag.path}: {' and '.join(sorted(chosen or present))} have {what} each; choose one, "
            f"as with {TOPIC_OPTION} {sorted(chosen or present)[0]}"
        )
    return chosen[0] if chosen else None
