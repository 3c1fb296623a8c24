"""Recordings with columns of any names and units, read by a map of them (`column_map`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, some_of
from cablesense_base.files import plain_name
from cablesense_recording.column_map import ColumnMap, NamedColumns
from cablesense_recording.csv_file import CSV_ENDINGS, csv_stem, read_table, stacked, whole_numbers
from cablesense_recording.first_command import FirstCommand
from cablesense_recording.layout import Described, Layout, layout_of
from cablesense_recording.mcap_file import decoded, is_bag
from cablesense_recording.mcap_messages import RawMessage
from cablesense_recording.recording import (
    MAX_NUMBERS,
    Recording,
    RecordingError,
    derive_trials,
    given_places,
    one_clock,
)
from cablesense_recording.units import FORCE_UNITS, LENGTH_UNITS

_JOINT_STATE = "sensor_msgs/msg/JointState"


def read_mapped(path: Path, machine: Described, columns: ColumnMap) -> Recording:
    """Read a CSV file, a .mcap file or a rosbag2 folder by a map of its columns.

    Without loads in the map there is none in any row; without trials these are derived. Of a bag
    each message of tensions is one row, with the latest command before it.

    Raises:
        RecordingError: no recording, or it lacks what the map names.
    """
    layout = layout_of(machine)
    if path.name.lower().endswith(CSV_ENDINGS):
        return _read_csv(path, layout, columns)
    if is_bag(path):
        return _read_bag(path, layout, columns)
    raise RecordingError(
        f"{path}: no recording; give a .csv file, a .mcap file or a rosbag2 folder"
    )


def _read_csv(path: Path, layout: Layout, columns: ColumnMap) -> Recording:
    tensions = columns.tension_columns(layout)
    commands = () if columns.commands.held else columns.command_columns(layout)
    wanted = [columns.time.column, *tensions, *commands]
    wanted += [columns.trial] if columns.trial else []
    loads = columns.loads
    optional: list[str] = []
    if loads is not None:
        is_given = len(layout.link_names) > 1
        (wanted if is_given else optional).append(loads.segment)
        wanted += loads.force
        optional += [loads.at] if loads.at else []
    values = read_table(path, [*wanted, *optional])
    missing = [name for name in wanted if name not in values]
    if missing:
        raise RecordingError(
            f"{path}: has no column {some_of(missing)}; name its columns in a map (--columns)"
        )
    count = len(values[columns.time.column])
    time = values[columns.time.column] - values[columns.time.column][:1]
    place_m = None
    segment = np.zeros(count, dtype=np.int64)
    load_n = np.zeros((count, 3))
    if loads is not None:
        load_n = stacked(values, loads.force) * FORCE_UNITS[loads.unit]
        if loads.segment in values:
            segment = whole_numbers(path, loads.segment, values[loads.segment])
        else:
            is_loaded = np.linalg.norm(load_n, axis=1) > loads.least
            segment = is_loaded.astype(np.int64)
            load_n *= is_loaded[:, None]
        if loads.at in values:
            place_m = given_places(values[loads.at] * LENGTH_UNITS[loads.at_unit])
    trial = whole_numbers(path, columns.trial, values[columns.trial]) if columns.trial else None
    held = np.tile(columns.commands.held, (count, 1))
    return _recording(
        csv_stem(path),
        time * columns.seconds,
        columns.commanded(stacked(values, commands) if commands else held),
        columns.readings(stacked(values, tensions)),
        segment,
        load_n,
        place_m,
        trial,
    )


def _read_bag(path: Path, layout: Layout, columns: ColumnMap) -> Recording:
    if columns.loads is not None or columns.trial:
        raise RecordingError(
            f"{path}: known loads and trials of a bag are not read by a map of columns; name its "
            "topics as the contract does (cable_tensions, joint_commands, applied_wrench, "
            "trial), or write the recording as CSV"
        )
    tension_topic = columns.tensions.topic or "/cable_tensions"
    command_topic = columns.commands.topic or f"/{layout.command_topic}"
    held = columns.commands.held
    command: Array | None = np.array(held) if held else None
    first_command = FirstCommand(command_topic)
    times_ns: list[tuple[int, int]] = []
    reading_count = 0
    messages: list[int] = []
    commands: list[Array] = []
    tensions: list[Array] = []
    topics: set[str] = set()

    def wanted(raw: RawMessage) -> bool:
        topics.add(raw.topic)
        return raw.topic in (tension_topic, command_topic)

    joints = layout.command_names
    channels = layout.channel_names
    most_rows = MAX_NUMBERS // (7 + len(joints) + len(channels))
    for raw, message in decoded(path, wanted):
        reading_count += raw.topic == tension_topic
        if raw.topic == tension_topic and not held:
            first_command.reading(raw.log_ns)
        if raw.topic == command_topic and not held:
            first_command.command(raw.log_ns)
            command = _numbers(path, raw, message, columns.commands, joints, "position")
        if raw.topic == tension_topic and command is not None:
            times_ns.append((raw.log_ns, _stamp_ns(message)))
            messages.append(reading_count)
            commands.append(command)
            tensions.append(_numbers(path, raw, message, columns.tensions, channels, "effort"))
        if len(times_ns) > most_rows:
            raise RecordingError(f"{path}: more than {most_rows} samples; split it")
    if not times_ns:
        present = some_of(sorted(topics), 8) or "nothing"
        needed = tension_topic if held else f"{tension_topic} after {command_topic}"
        raise RecordingError(f"{path}: has no message on {needed}, but {present}")
    logs_ns, stamps_ns = np.array(times_ns, dtype=np.int64).T
    clock_ns = one_clock(path, logs_ns, stamps_ns).time_ns
    count = len(times_ns)
    recording = _recording(
        plain_name(path.stem),
        (clock_ns - clock_ns[0]).astype(np.float64) * 1e-9,
        columns.commanded(np.array(commands)),
        columns.readings(np.array(tensions)),
        np.zeros(count, dtype=np.int64),
        np.zeros((count, 3)),
        None,
        None,
    )
    return replace(
        recording,
        message=np.array(messages, dtype=np.int64),
        notes=(*recording.notes, *first_command.notes),
        commanded_inside=first_command.comes_inside,
    )


def _recording(
    name: str,
    time_s: Array,
    command_rad: Array,
    tensions_n: Array,
    segment: NDArray[np.int64],
    load_n: Array,
    place_m: Array | None,
    trial: NDArray[np.int64] | None,
) -> Recording:
    if trial is None:
        trial = derive_trials(time_s, command_rad, segment, load_n, place_m)
    return Recording(
        name=name,
        time_s=time_s,
        trial=trial,
        command_rad=command_rad,
        load_segment=segment,
        load_n=load_n,
        tensions_n=tensions_n,
        load_at_m=place_m,
    )


def _numbers(
    path: Path,
    raw: RawMessage,
    message: Any,
    channels: NamedColumns,
    names: Sequence[str],
    usual_field: str,
) -> Array:
    """The numbers of one message, in the machine's order."""
    if raw.kind == _JOINT_STATE:
        values = list(getattr(message, channels.field or usual_field))
        by_name = dict(zip(message.name, values, strict=False))
        wanted = channels.columns or names
        missing = [name for name in wanted if name not in by_name]
        if missing:
            raise RecordingError(
                f"{path}: {raw.topic}: {channels.field or usual_field} has no value of "
                f"{some_of(missing)}, but of {some_of(list(by_name), 4) or 'none'}"
            )
        return np.array([by_name[name] for name in wanted], dtype=float)
    data = getattr(message, "data", None)
    if data is None or np.size(data) != len(names):
        raise RecordingError(
            f"{path}: {raw.topic} is of type {raw.kind[:80]!r}; needed is {_JOINT_STATE}, or an "
            f"array of {len(names)} numbers in its field data"
        )
    return np.asarray(data, dtype=float).ravel()


def _stamp_ns(message: Any) -> int:
    header = getattr(message, "header", None)
    return 0 if header is None else header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
