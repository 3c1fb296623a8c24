"""A recording of a robot: positions, torques and commands under its model's names.

CSV files and bags become the same table of channels, and the same checks are made of both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, some_of
from cablesense_base.files import plain_name
from cablesense_recording.channel_checks import (
    constant_channels,
    dead_position,
    dead_torque,
    huge_values,
    leap_sentence,
    leaps_and_returns,
    parted_sentence,
    position_leaps,
    robot_breaks,
    time_findings,
    uneven_time,
)
from cablesense_recording.channels import TIME, TRIAL, Channel, Kind, RobotChannels
from cablesense_recording.csv_file import CSV_ENDINGS, csv_stem, read_table
from cablesense_recording.efforts import (
    MEANINGS,
    READ_FIRST,
    Effort,
    Meaning,
    chosen_efforts,
    effort_sentences,
    in_known_units,
    stated_efforts,
)
from cablesense_recording.joint_states import bag_table
from cablesense_recording.mcap_file import is_bag
from cablesense_recording.poses import Kinematics, with_positions
from cablesense_recording.recording import Finding, RecordingError, RowNames
from cablesense_recording.units import OTHER_TIME_UNITS, time_unit_of

FEWEST_TRIALS = 5
"""Fewer are cut into stretches, so that there is something to hold out."""

_PREFIXES = (
    *(TIME, "time", TRIAL, "position.", "command.", "pose."),
    *(f"{word}." for word in MEANINGS),
)
_STILL_S = 0.5
_STILL_SHARE = 0.01
"""A joint slower than this share of its largest speed is standing still."""
_MOST_STRETCH_S = 20.0
_LEAST_STRETCH_S = 1.0
_MOST_RAD = 4.0 * np.pi
_MOST_RAD_S = 30.0
"""No joint with a range goes farther; one without, as a drum, goes farther, but not faster."""
_MOST_INTERVAL_S = 0.5
_LEAST_SPEED = 0.005
"""At longer intervals a joint that is never faster, in rad/s or m/s, has another unit of time."""

_Columns = dict[str, Array]

TrialLabel = int | str
"""A trial's number in the user's file, or that and the file's name."""


@dataclass(frozen=True)
class RobotRecording:
    """R rows in the order of time within each trial, names as the robot has them.

    Attributes:
        name: of the file or folder.
        time_s: (R,) beginning anew where a file does.
        trial: (R,) 0 to T - 1, blocks that are held out whole.
        position: (R, J) of the joints, rad or m.
        torque: (R, J) of the drives at the joints, N·m or N, but for currents whose factor is
            unknown; NaN for joints without.
        command: (R, A) of the actuators' inputs; NaN for those without.
        notes: what was read, and what was changed, as sentences.
        warnings: what looks wrong, as sentences.
        efforts: (J,) what the torques were recorded as; torques where it is empty.
        trial_labels: (T,) what the files call each trial, as of `trial_label`.
    """

    name: str
    time_s: Array
    trial: NDArray[np.int64]
    position: Array
    torque: Array
    command: Array
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    efforts: tuple[Effort, ...] = ()
    trial_labels: tuple[TrialLabel, ...] = ()

    def trial_label(self, trial: int) -> TrialLabel:
        """What the recording's user knows a trial by, one of `trial`.

        Its number in the file, with the file's name where there are several, as `3 of run_2.csv`.
        Parts of one trial have one label. A file without numbers has its trials counted from 0;
        so has a recording that was read from none.
        """
        return self.trial_labels[trial] if self.trial_labels else trial

    @property
    def stated_efforts(self) -> tuple[bool, ...]:
        """(J,) whether a user has said what the efforts are."""
        joints = self.position.shape[1]
        return tuple(each.stated for each in self.efforts) or (False,) * joints

    @property
    def unknown_gain(self) -> NDArray[np.bool_]:
        """(J,) whether torques are currents whose torque constant is unknown."""
        unknown = [each.factor is None for each in self.efforts]
        return np.array(unknown or [False] * self.position.shape[1])

    def __len__(self) -> int:
        """How many rows."""
        return len(self.time_s)


@dataclass(frozen=True)
class _FileRows:
    """The rows of one file, or one bag, in their order: a part of the recording.

    Attributes:
        path: of it.
        first_row: number of the first row that is used, from 1.
        columns: time_s (R,), trial (R,), position (R, J), torque (R, J), command (R, A).
        notes: what was changed, as sentences.
        warnings: what looks wrong, as sentences.
        stated_trial: (R,) the file's own numbers of trials, where it has some.
    """

    path: Path
    first_row: int
    columns: _Columns
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    stated_trial: Array | None

    @property
    def numbered(self) -> bool:
        """Whether trials have numbers."""
        return self.stated_trial is not None


def read_by_channels(
    path: str | Path,
    channels: RobotChannels,
    topics: Sequence[str] = (),
    *,
    efforts: Sequence[str] = (),
    kinematics: Kinematics | None = None,
    force: bool = False,
) -> RobotRecording:
    """Read a .csv or .csv.gz file, a folder of them, a .mcap file or a rosbag2 folder.

    Files of a folder do not share trials. `topics` are those of a bag to read where several fit.
    `efforts` state what efforts are, where these are no torques in N·m or N, as of
    `efforts.stated_efforts`. With `kinematics` joints that have no positions are found by poses.
    With `force` a channel that stands still while its joint moves is no reason to refuse, nor
    are positions that are large for rad, as those of a drum.

    Raises:
        RecordingError: no such file, neither CSV nor a bag, a column missing or of another robot,
            a cell that is not a number, degrees or milliseconds, time that does not increase,
            several topics that fit, several publishers, or a dead channel.
    """
    path = Path(path)
    notes: list[str] = []
    stated = stated_efforts(efforts, channels.joint_numbers, channels.joint_names)
    bag = is_bag(path)
    if bag:
        nothing: list[set[Meaning]] = [set() for _ in channels.joints]
        channels = replace(channels, efforts=chosen_efforts(nothing, stated))
        table, notes = bag_table(path, channels, topics)
        tables = {path: table}
    else:
        if topics:
            raise RecordingError(f"{path}: is no bag, so it has no topic {some_of(topics)}")
        tables = {file: _labelled(file, channels) for file in _files(path)}
        channels, tables = _with_efforts(path, tables, channels, stated)
    for file, table in tables.items():
        tables[file], sentences = with_positions(file, table, channels, kinematics)
        notes += sentences
    parts = [_file_rows(file, table, channels, bag) for file, table in tables.items()]
    warnings: list[str] = []
    for part in parts:
        notes += part.notes
        warnings += part.warnings
    every = _columns_of_all(parts)
    uncut = _uncut_trials(parts)
    warnings += _check_units(path, channels, every, uncut, force=force)
    trial, note = _trials(parts, uncut)
    every[TRIAL] = trial.astype(np.float64)
    constant = [
        number
        for number in constant_channels(channels.labels(Kind.TORQUE), every["torque"])
        if channels.driven[number] or every["torque"][0, number] != 0.0
    ]
    warnings += [
        f"{channels.labels(Kind.TORQUE)[number]} is {every['torque'][0, number]:g} in every row, "
        "whatever moves, so it is not compared; see whether its sensor is connected."
        for number in constant
    ]
    for part in parts:
        findings = list(_dead_channels(channels, part, constant))
        refusals = [each.text for each in findings if each.refuses and not force]
        if refusals:
            more = f" (and {len(refusals) - 1} more)" if len(refusals) > 1 else ""
            raise RecordingError(f"{part.path}: {refusals[0]}{more}, or continue with --force")
        warnings += [f"{each.text}." for each in findings]
    torque = every["torque"]
    torque[:, constant] = np.nan
    measured = np.flatnonzero(np.isfinite(torque).any(axis=0)).tolist()
    of_measured = [channels.efforts[joint] for joint in measured]
    notes += effort_sentences(of_measured, [channels.joint_names[joint] for joint in measured])
    if not np.isfinite(torque).any():
        warnings += _constant_commands(channels, every["command"])
    return RobotRecording(
        name=plain_name(path.name) if path.is_dir() else csv_stem(path),
        time_s=every[TIME],
        trial=trial,
        position=every["position"],
        torque=in_known_units(torque, channels.efforts),
        command=every["command"],
        notes=(*notes, note),
        warnings=tuple(warnings),
        efforts=channels.efforts,
        trial_labels=tuple(_trial_labels(parts, trial)),
    )


def _constant_commands(channels: RobotChannels, command: Array) -> list[str]:
    """Sentences about commands that never change, where nothing else drives the model."""
    labels = channels.labels(Kind.COMMAND)
    return [
        f"{labels[number]} is {command[0, number]:g} in every row, whatever moves; see whether it "
        "was recorded."
        for number in constant_channels(labels, command)
    ]


def _columns_of_all(parts: Sequence[_FileRows]) -> _Columns:
    """The columns of all files, one after the other."""
    kinds = parts[0].columns
    return {kind: np.concatenate([part.columns[kind] for part in parts]) for kind in kinds}


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise RecordingError(
            f"{path}: no such file; give a .csv, .csv.gz or .mcap file, or a folder"
        )
    files = sorted(f for f in path.iterdir() if f.name.endswith(CSV_ENDINGS) and f.is_file())
    if not files:
        raise RecordingError(f"{path}: holds no .csv and no .csv.gz file, and is no rosbag2")
    return files


def _labelled(path: Path, channels: RobotChannels) -> _Columns:
    """Columns of a CSV file under their labels, however they spell the names."""
    table: _Columns = {}
    for column, values in read_table(path, _PREFIXES).items():
        label = channels.label_of(column)
        if label in table:
            raise RecordingError(f"{path}: column {label} appears twice; once is right")
        table[label] = values
    return table


def _with_efforts(
    path: Path, tables: dict[Path, _Columns], channels: RobotChannels, stated: Mapping[int, Effort]
) -> tuple[RobotChannels, dict[Path, _Columns]]:
    """The channels by the kinds of efforts that columns name, and the tables with their labels.

    Of a joint that has several the torque is read: logs have currents beside it.

    Raises:
        RecordingError: a column says otherwise than a user.
    """
    columns = {column for table in tables.values() for column in table}
    present = [
        {meaning for meaning in Meaning if f"{meaning.value}.{joint}" in columns}
        for joint in channels.joints
    ]
    try:
        chosen = chosen_efforts(present, stated)
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from error
    of_efforts = replace(channels, efforts=chosen)
    known = set(channels.joints)
    any_torque = any(Meaning.TORQUE in meanings for meanings in present)
    labelled = {}
    for file, table in tables.items():
        labelled[file] = dict(table)
        for column in table:
            word, _, joint = column.partition(".")
            surplus = word in MEANINGS and joint not in known and word != Meaning.TORQUE.value
            if surplus and any_torque:
                del labelled[file][column]  # as a log's `current.motor_3`
        for joint, label, meanings in zip(
            channels.joints, of_efforts.labels(Kind.TORQUE), present, strict=True
        ):
            in_table = [each for each in Meaning if f"{each.value}.{joint}" in table]
            efforts = {each: labelled[file].pop(f"{each.value}.{joint}") for each in in_table}
            first = next((each for each in READ_FIRST if each in meanings), None)
            if first in efforts:
                labelled[file][label] = efforts[first]
    return of_efforts, labelled


def _file_rows(path: Path, table: _Columns, channels: RobotChannels, bag: bool) -> _FileRows:
    """The rows of one file, from the first on in which all its channels have begun.

    Raises:
        RecordingError: a column is missing or of another robot, a cell is empty, or time does not
            increase.
    """
    rows = _row_count(path, table)
    _refuse_other_names(path, table, channels)
    present = [channel for channel in channels.table if channel.label in table]
    measured = [each for each in present if each.needed or not np.isnan(table[each.label]).all()]
    numbered = any(channel.kind is Kind.TRIAL for channel in measured)
    begin, end = _complete_range(table, measured)
    _refuse_impossible_cells(path, table, measured, begin, end)
    trial = np.zeros(rows, dtype=np.int64)
    if numbered:
        trial = np.cumsum(np.diff(table[TRIAL], prepend=table[TRIAL][0]) != 0.0)
    _refuse_impossible_times(path, table[TIME], trial, bag=bag)
    notes = list(_trimmed(measured, rows, begin, end))
    if end - begin < 2:
        raise RecordingError(
            f"{path}: no two rows have numbers in all of {some_of([c.label for c in measured])}"
        )
    used = slice(begin, end)
    first_row = begin + 1
    time_s = table[TIME][used]
    trial = trial[used] - trial[begin]
    if numbered:
        notes += _notes_on_returning_trials(table[TRIAL][used], trial)
    position = _stacked(table, channels.labels(Kind.POSITION), used)
    parts, parted, warnings = _parting_rows(path, channels, time_s, trial, position, first_row)
    notes += parted
    by_number = trial + np.cumsum(parts)
    trial = by_number if numbered else _by_pauses(time_s, position, parts)
    columns = {
        TIME: time_s,
        TRIAL: trial.astype(np.float64),
        "position": position,
        "torque": _stacked(table, channels.labels(Kind.TORQUE), used),
        "command": _stacked(table, channels.labels(Kind.COMMAND), used),
    }
    return _FileRows(
        path=path,
        first_row=first_row,
        columns=columns,
        notes=tuple(notes),
        warnings=tuple(warnings),
        stated_trial=table[TRIAL][used] if numbered else None,
    )


def _row_count(path: Path, table: _Columns) -> int:
    """Rows of a table that has times."""
    if TIME not in table:
        near = [name for name in table if "time" in name.lower()]
        hint = f"; {near[0]} is there: it must be time_s, in seconds" if near else ""
        raise RecordingError(f"{path}: misses column time_s{hint}")
    rows = len(table[TIME])
    if rows < 2:
        raise RecordingError(f"{path}: has {rows} rows; a recording of motion has thousands")
    return rows


def _refuse_impossible_cells(
    path: Path, table: _Columns, measured: Sequence[Channel], begin: int, end: int
) -> None:
    """Refuse empty cells in the rows from `begin` to `end`, and numbers of no measurement."""
    for channel in measured:
        values = table[channel.label]
        _refuse_gaps(path, channel, values, begin, end)
        if channel.kind not in (Kind.TIME, Kind.TRIAL):
            for finding in huge_values(channel.label, values, _row_names(values)):
                raise RecordingError(f"{path}: {finding.text}")


def _refuse_impossible_times(
    path: Path, time_s: Array, trial: NDArray[np.int64], *, bag: bool
) -> None:
    """Refuse times (R,) that do not increase; those of a file may begin again with a trial."""
    may_restart = np.append(False, np.diff(trial) != 0) & (not bag)
    for finding in time_findings(time_s, may_restart, _row_names(time_s), of_bag=bag):
        raise RecordingError(f"{path}: {finding.text}")


def _row_names(column: Array) -> RowNames:
    """Those of all rows of a file, from 1."""
    return RowNames(np.arange(1, len(column) + 1))


def _stacked(table: _Columns, labels: Sequence[str], used: slice) -> Array:
    """(R, C) columns of some labels in the rows that are used; NaN where there is none."""
    nothing = np.full(len(table[TIME]), np.nan)
    columns = [table.get(label, nothing)[used] for label in labels]
    count = used.stop - used.start
    return np.ascontiguousarray(np.array(columns).reshape(len(labels), count).T)


def _parting_rows(
    path: Path,
    channels: RobotChannels,
    time_s: Array,
    trial: NDArray[np.int64],
    position: Array,
    first_row: int,
) -> tuple[NDArray[np.bool_], list[str], list[str]]:
    """(R,) rows before which there is a break, or a position (R, J) leaps; notes and warnings.

    Raises:
        RecordingError: times are uneven, or positions leap back and forth.
    """
    notes: list[str] = []
    warnings: list[str] = []
    is_break = robot_breaks(time_s, trial)
    if is_break.any():
        notes.append(parted_sentence(time_s, is_break, first_row))
    parted = trial + np.cumsum(is_break)
    for finding in uneven_time(time_s, parted):
        raise RecordingError(f"{path}: {finding.text}")
    of_positions = [channel for channel in channels.table if channel.kind is Kind.POSITION]
    for channel, joint_position in zip(of_positions, position.T, strict=True):
        for finding in leaps_and_returns(channel, joint_position, parted, first_row):
            if finding.refuses:
                raise RecordingError(f"{path}: {finding.text}")
            warnings.append(f"{finding.text}.")
    jump = position_leaps(position, parted)
    if jump.any():
        labels = channels.labels(Kind.POSITION)
        notes.append(leap_sentence(labels, position, jump, first_row))
    return is_break | jump, notes, warnings


def _complete_range(table: _Columns, measured: Sequence[Channel]) -> tuple[int, int]:
    """The first row in which all channels have begun, and the row behind the last of all.

    Drives are often enabled after the recorder has started: efforts are missing till then, or 0.
    """
    labels = [channel.label for channel in measured if channel.kind not in (Kind.TIME, Kind.TRIAL)]
    known = np.all([np.isfinite(table[label]) for label in labels], axis=0)
    torques = [table[each.label] for each in measured if each.kind is Kind.TORQUE]
    if torques:
        enabled = np.any([np.nan_to_num(torque) != 0.0 for torque in torques], axis=0)
        known &= np.maximum.accumulate(enabled) if enabled.any() else True
    rows = np.flatnonzero(known)
    return (int(rows[0]), int(rows[-1]) + 1) if rows.size else (0, len(known))


def _trimmed(measured: Sequence[Channel], rows: int, begin: int, end: int) -> Iterator[str]:
    kinds = {channel.kind for channel in measured}
    what = "torques" if Kind.TORQUE in kinds else "commands"
    if begin:
        yield f"The first {begin} of {rows} rows are left out, before all {what} have begun."
    if end < rows:
        yield f"The last {rows - end} of {rows} rows are left out, after some channels have ended."


def _refuse_gaps(path: Path, channel: Channel, values: Array, begin: int, end: int) -> None:
    gaps = np.flatnonzero(~np.isfinite(values))
    if channel.kind not in (Kind.TIME, Kind.TRIAL):
        gaps = gaps[(gaps >= begin) & (gaps < end)]
    if gaps.size:
        more = f" and {len(gaps) - 1} more" if len(gaps) > 1 else ""
        remedy = "" if channel.needed else ", or leave the column out"
        raise RecordingError(
            f"{path}: row {gaps[0] + 1}{more}, column {channel.label}: empty or not finite; fill "
            f"every row{remedy}"
        )


def _notes_on_returning_trials(numbers: Array, trial: NDArray[np.int64]) -> list[str]:
    """A sentence if a trial's number comes back after another one."""
    starts = np.append(True, np.diff(trial) != 0)
    values, counts = np.unique(numbers[starts], return_counts=True)
    if not (counts > 1).any():
        return []
    number = _plain_number(values[counts > 1][0])
    return [
        f"Trial {number} comes back after another one; its parts count as trials of their own."
    ]


def _refuse_other_names(path: Path, table: _Columns, channels: RobotChannels) -> None:
    """Joints and actuators of another robot; joints without a position."""
    known = {channel.label for channel in channels.table}
    labels = zip(channels.labels(Kind.POSITION), channels.joint_names, strict=True)
    missing = [name for label, name in labels if label not in table]
    others = [name for name in table if "." in name and name not in known]
    surplus = sorted({name.partition(".")[2] for name in others})
    defects = [f"misses the position of {some_of(missing)}"] if missing else []
    defects += [f"has {some_of(surplus)}, which the model has not"] if surplus else []
    if defects:
        actuators = some_of(channels.actuators, 12)
        raise RecordingError(
            f"{path}: {' and '.join(defects)}; {channels.model} has the joints "
            f"{some_of(channels.joint_names, 12)}"
            + (f" and the actuators {actuators}" if channels.actuators else "")
        )


def _uncut_trials(parts: Sequence[_FileRows]) -> NDArray[np.int64]:
    """(R,) by column, by file, or by pauses."""
    trials: list[NDArray[np.int64]] = []
    begin = 0
    for part in parts:
        trials.append(begin + part.columns[TRIAL].astype(np.int64))
        begin = int(trials[-1].max()) + 1
    return np.concatenate(trials)


def _trials(parts: Sequence[_FileRows], uncut: NDArray[np.int64]) -> tuple[NDArray[np.int64], str]:
    """These trials (R,), cut into stretches where there are too few; and how, as a sentence."""
    how = "by their column" if all(part.numbered for part in parts) else "by file and pause"
    count = int(uncut.max()) + 1
    if count >= FEWEST_TRIALS:
        return uncut, f"Trials {how}."
    trial = _cut(np.concatenate([part.columns[TIME] for part in parts]), uncut)
    stretches = int(trial.max()) + 1
    return trial, f"Trials {how}, {count} in all, cut into {stretches} stretches."


def _trial_labels(parts: Sequence[_FileRows], trial: NDArray[np.int64]) -> Iterator[TrialLabel]:
    """The label of each of the trials (R,) of all parts, as of `RobotRecording.trial_label`."""
    first_row = 0
    for part in parts:
        of_part = trial[first_row : first_row + len(part.columns[TIME])]
        first_row += len(of_part)
        _, first_rows = np.unique(of_part, return_index=True)
        for count, row in enumerate(first_rows):
            number: TrialLabel = count
            if part.stated_trial is not None:
                number = _plain_number(part.stated_trial[row])
            yield number if len(parts) == 1 else f"{number} of {part.path.name}"


def _plain_number(value: float) -> TrialLabel:
    """A number as files state it: whole where it is."""
    return int(value) if float(value).is_integer() else f"{value:.12g}"


def _by_pauses(time_s: Array, position: Array, parts: NDArray[np.bool_]) -> NDArray[np.int64]:
    """A trial begins in the middle of each rest of all joints, and where `parts` (R,) is true."""
    interval = np.diff(time_s, prepend=time_s[0])
    typical = float(np.median(interval[1:]))
    window = max(1, round(0.1 / max(typical, 1e-6)))
    moved = np.abs(position[window:] - position[:-window])
    far = np.zeros(len(time_s), dtype=bool)
    far[: len(moved)] = (moved > _STILL_SHARE * moved.max(0, initial=0.0) + 1e-9).any(1)
    edges = np.flatnonzero(np.diff(far.astype(int), prepend=1, append=1))
    rests = [
        (first + end) // 2
        for first, end in zip(edges[::2], edges[1::2], strict=False)
        if time_s[min(end, len(time_s) - 1)] - time_s[first] >= _STILL_S
        and 0 < first < end < len(time_s)
        and not parts[first : end + window + 1].any()  # it is parted there already
    ]
    marks = parts.astype(np.int64)
    marks[rests] = 1
    return np.cumsum(marks)


def _cut(time_s: Array, trial: NDArray[np.int64]) -> NDArray[np.int64]:
    """Trials cut into stretches, ten in all where they are long enough."""
    spans = [np.ptp(time_s[trial == t]) for t in np.unique(trial)]
    stretch_s = max(_LEAST_STRETCH_S, min(sum(spans) / (2 * FEWEST_TRIALS), _MOST_STRETCH_S))
    cut = np.zeros_like(trial)
    begin = 0
    for t, span in zip(np.unique(trial), spans, strict=True):
        rows = trial == t
        pieces = max(1, int(span / stretch_s))
        since = (time_s[rows] - time_s[rows][0]) / max(span, 1e-9)
        cut[rows] = begin + np.minimum((since * pieces).astype(int), pieces - 1)
        begin += pieces
    return cut


def _check_units(
    path: Path,
    channels: RobotChannels,
    every: Mapping[str, Array],
    uncut: NDArray[np.int64],
    *,
    force: bool,
) -> list[str]:
    """Units of time, degrees, and a robot that does not move; what `force` lets pass, as warnings.

    Of the trials (R,) that are `uncut`: those that stretches of seconds make are single rows in
    another unit.
    """
    warnings = []
    interval = np.diff(every[TIME])
    within = np.diff(uncut) == 0
    position = every["position"]
    typical = float(np.median(interval[within])) if within.any() else 0.0
    step = np.abs(np.diff(position, axis=0)[within])
    speed = (step / interval[within, None]).max(0, initial=0.0)
    if typical > _MOST_INTERVAL_S and speed.max() < _LEAST_SPEED:
        shortest_s = _MOST_INTERVAL_S * OTHER_TIME_UNITS["milliseconds"]
        unit = time_unit_of(typical, (shortest_s, _MOST_INTERVAL_S)) or "another unit"
        raise RecordingError(
            f"{path}: rows are {typical:g} s apart and joints reach {speed.max():.2g} in 1 s; "
            f"time_s must be in seconds ({unit} given?)"
        )
    hinges = np.array([unit == "rad" for unit in channels.position_units])
    hinges &= np.array(channels.limited) | (speed > _MOST_RAD_S)
    largest = np.abs(position[:, hinges]).max(initial=0.0)
    if largest > _MOST_RAD:
        text = f"positions reach {largest:.4g}; they must be in rad (degrees given?)"
        if not force:
            raise RecordingError(f"{path}: {text}; if they are, continue with --force")
        warnings.append(f"{text[0].upper()}{text[1:]}.")
    moved = np.ptp(position, axis=0)
    if moved.max(initial=0.0) <= 0.0:
        raise RecordingError(f"{path}: no joint moves; a recording of motion is right")
    return warnings


def _dead_channels(
    channels: RobotChannels, part: _FileRows, constant: Sequence[int]
) -> Iterator[Finding]:
    """Channels that do not follow what they measure; torques that are `constant` are known."""
    positions = channels.labels(Kind.POSITION)
    torques = channels.labels(Kind.TORQUE)
    trial = part.columns[TRIAL].astype(np.int64)
    for number in range(len(positions)):
        position = part.columns["position"]
        torque = part.columns["torque"][:, number]
        yield from dead_position(positions, position, number, part.first_row)
        judged = number not in constant and (channels.driven[number] or torque.any())
        if judged and np.isfinite(torque).all():
            yield from dead_torque(
                torques[number], torque, position[:, number], trial, part.first_row
            )
