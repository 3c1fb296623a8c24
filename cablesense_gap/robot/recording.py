"""A recording of a robot: positions, torques, commands and sensors under the model's names."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, some_of
from cablesense_gap.recordings.csv_file import CSV_ENDINGS, csv_stem, read_table
from cablesense_gap.recordings.mcap_file import decoded, is_bag
from cablesense_gap.recordings.mcap_messages import RawMessage
from cablesense_gap.recordings.recording import MAX_NUMBERS, RecordingError
from cablesense_gap.robot.model import Robot
from cablesense_msgs_py.qos import JOINT_STATE_TYPE, NUMBER_TYPE

FEWEST_TRIALS = 5
"""Fewer are cut into stretches, so that there is something to hold out."""

_NUMBERS_TYPE = "std_msgs/msg/Float64MultiArray"
_KINDS = ("position", "velocity", "torque", "command")
_PREFIXES = ("time", "trial", *(f"{kind}." for kind in _KINDS))
_STILL_S = 0.5
_STILL_SHARE = 0.01
"""A joint slower than this share of its largest speed is standing still."""
_MOST_STRETCH_S = 20.0
_LEAST_STRETCH_S = 1.0
_MOST_RAD = 4.0 * np.pi
_OTHER_UNIT = 10.0
_MOST_INTERVAL_S = 1.0


@dataclass(frozen=True)
class RobotRecording:
    """R rows in the order of time within each trial, names as the robot has them.

    Attributes:
        name: of the file or folder.
        time_s: (R,) beginning anew where a file does.
        trial: (R,) 0 to T - 1, blocks that are held out whole.
        position: (R, J) of the joints, rad or m.
        torque: (R, J) of the drives at the joints, N·m or N; NaN for joints without.
        command: (R, A) of the actuators; NaN for those without.
        notes: changes made to it, as sentences.
    """

    name: str
    time_s: Array
    trial: NDArray[np.int64]
    position: Array
    torque: Array
    command: Array
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        """How many rows."""
        return len(self.time_s)


def read_recording(path: str | Path, robot: Robot) -> RobotRecording:
    """Read a .csv or .csv.gz file, a folder of them, a .mcap file or a rosbag2 folder.

    Files of a folder do not share trials.

    Raises:
        RecordingError: no such file, not CSV, a column missing or of another robot, a cell that
            is not a number, degrees or milliseconds, or time that does not increase.
    """
    path = Path(path)
    if is_bag(path):
        files, tables = [path], [bag_table(path, robot)]
    else:
        files = _files(path)
        tables = [read_table(file, _PREFIXES) for file in files]
    parts = [_part(file, table, robot) for file, table in zip(files, tables, strict=True)]
    trials, notes = _trials(parts, tables)
    name = path.name if path.is_dir() else csv_stem(path)
    every = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    _check(path, robot, every, trials)
    for file, table, part in zip(files, tables, parts, strict=True):
        _check_speeds(file, robot, table, part["position"])
    return RobotRecording(name, trial=trials, notes=notes, **every)


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


def bag_table(path: Path, robot: Robot) -> dict[str, Array]:
    """Columns of a recording as a CSV has them: one row per state of all the robot's joints.

    Positions, velocities and efforts come from the joint states. Commands come from a topic whose
    joint states name the actuators, or whose numbers are as many as the actuators and whose name
    contains `command`: the latest before each row. Trials come from a topic `trial`; rows before
    the first number are a separate trial. Without efforts, rows begin with the first command.

    Raises:
        RecordingError: no bag, one too large, or no joint states with the robot's joints.
    """

    def wanted(raw: RawMessage) -> bool:
        return raw.kind in (JOINT_STATE_TYPE, NUMBER_TYPE, _NUMBERS_TYPE)

    rows = _BagColumns(robot)
    for raw, message in decoded(path, wanted):
        rows.take(raw.topic, raw.log_ns, message)
        if rows.numbers > MAX_NUMBERS:
            raise RecordingError(f"{path}: more than {MAX_NUMBERS} numbers; split it")
    return rows.table(path)


class _BagColumns:
    """The rows that messages of a robot make."""

    def __init__(self, robot: Robot) -> None:
        self._robot, self._names = robot, set[str]()
        self._topic = ""
        self._values = array("d")
        self._command = np.full(len(robot.actuators), np.nan)
        self._trial = np.nan

    @property
    def numbers(self) -> int:
        """How many are kept."""
        return len(self._values)

    def take(self, topic: str, log_ns: int, message: Any) -> None:
        """One message; those that are not of this robot are skipped."""
        robot, commands = self._robot, "command" in topic
        if hasattr(message, "data"):
            if topic.rpartition("/")[2] == "trial" and np.ndim(message.data) == 0:
                self._trial = float(message.data)
            elif commands and np.shape(message.data) == self._command.shape:
                self._command = np.asarray(message.data, dtype=float)
            return
        self._names |= set(message.name)
        if commands and robot.actuators and set(robot.actuators) <= set(message.name):
            given = message.effort if len(message.effort) else message.position
            command = _in_order(message.name, given, robot.actuators)
            self._command = self._command if command is None else command
            return
        if not set(robot.joints) <= set(message.name):
            return
        position = _in_order(message.name, message.position, robot.joints)
        self._topic = self._topic or (topic if position is not None else "")
        if position is None or topic != self._topic:
            return
        torque = _in_order(message.name, message.effort, robot.joints)
        torque = np.full(len(position), np.nan) if torque is None else torque
        stamp_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self._values.extend((stamp_s or 1e-9 * log_ns, self._trial))
        for values in (position, torque, self._command):
            self._values.extend(values)

    def table(self, path: Path) -> dict[str, Array]:
        """All rows, time from the first."""
        robot = self._robot
        labels = ["time_s", "trial"]
        labels += [f"{kind}.{joint}" for kind in ("position", "torque") for joint in robot.joints]
        labels += [f"command.{name}" for name in robot.actuators]
        values = np.array(self._values).reshape(-1, len(labels))
        if not len(values):
            there = some_of(sorted(self._names)) or "none"
            raise RecordingError(
                f"{path}: holds no {JOINT_STATE_TYPE} with the joints {some_of(robot.joints)}; it "
                f"names {there}"
            )
        count = len(robot.joints)
        _, torque, command = np.split(values[:, 2:], [count, 2 * count], axis=1)
        if not np.isfinite(torque).any():  # commands drive the model, and are not known before
            values = values[np.isfinite(command).all(axis=1).argmax() :]
        table = dict(zip(labels, values.T, strict=True))
        table["time_s"] = table["time_s"] - table["time_s"][0]
        numbered = np.isfinite(table["trial"])
        if numbered.any():
            table["trial"] = np.where(numbered, table["trial"], np.nanmin(table["trial"]) - 1.0)
        else:
            del table["trial"]
        return table


def _in_order(names: Sequence[str], values: Any, wanted: Sequence[str]) -> Array | None:
    """Values of the wanted names; none unless there is one value for each name."""
    if len(values) != len(names):
        return None
    at = {name: k for k, name in enumerate(names)}
    return np.asarray(values, dtype=float)[[at[name] for name in wanted]]


def _part(path: Path, table: dict[str, Array], robot: Robot) -> dict[str, Array]:
    """Arrays of one file by the names of `RobotRecording`."""
    if "time_s" not in table:
        near = [name for name in table if "time" in name.lower()]
        hint = f"; {near[0]} is there: it must be time_s, in seconds" if near else ""
        raise RecordingError(f"{path}: misses column time_s{hint}")
    rows = len(table["time_s"])
    if rows < 2:
        raise RecordingError(f"{path}: has {rows} rows; a recording of motion has thousands")
    _refuse_other_names(path, table, robot)
    _refuse_gaps(path, table, robot)

    def stacked(kind: str, names: Sequence[str]) -> Array:
        nothing = np.full(rows, np.nan)
        return np.stack([table.get(f"{kind}.{name}", nothing) for name in names], axis=1)

    return {
        "time_s": table["time_s"],
        "position": stacked("position", robot.joints),
        "torque": stacked("torque", robot.joints),
        "command": stacked("command", robot.actuators) if robot.actuators else np.empty((rows, 0)),
    }


def _check_speeds(path: Path, robot: Robot, table: dict[str, Array], position: Array) -> None:
    """Speeds that are read must be those of the positions, in one unit of time and angle."""
    for joint, own in zip(robot.joints, position.T, strict=True):
        speed = table.get(f"velocity.{joint}")
        if speed is None:
            continue
        way, moved = np.diff(own), 0.5 * (speed[1:] + speed[:-1]) * np.diff(table["time_s"])
        far = np.abs(way) > 0.5 * np.quantile(np.abs(way), 0.95)
        ratio = abs(float(np.median(moved[far] / way[far]))) if far.any() else 1.0
        if ratio > _OTHER_UNIT or 0.0 < ratio < 1.0 / _OTHER_UNIT:
            raise RecordingError(
                f"{path}: velocity.{joint} is {ratio:.3g} times what position.{joint} and time_s "
                "make; rad, rad/s and s are right (m and m/s of a slide)"
            )


def _refuse_other_names(path: Path, table: dict[str, Array], robot: Robot) -> None:
    """Joints and actuators of another robot; joints without a position."""
    split = (name.partition(".") for name in table)
    named = [(kind, name) for kind, _, name in split if kind in _KINDS]
    joints = {name for kind, name in named if kind in ("position", "velocity", "torque")}
    missing = [j for j in robot.joints if ("position", j) not in named]
    surplus = sorted(joints - set(robot.joints))
    surplus += sorted({n for k, n in named if k == "command"} - set(robot.actuators))
    if not missing and not surplus:
        return
    found = [f"misses position.{missing[0]}"] if len(missing) == 1 else []
    found += [f"misses the positions of {some_of(missing)}"] if len(missing) > 1 else []
    found += [f"has {some_of(surplus)}, which the model has not"] if surplus else []
    raise RecordingError(
        f"{path}: {' and '.join(found)}; {robot.path.name} has the joints "
        f"{some_of(robot.joints, 12)}"
        + (f" and the actuators {some_of(robot.actuators, 12)}" if robot.actuators else "")
    )


def _refuse_gaps(path: Path, table: dict[str, Array], robot: Robot) -> None:
    """Cells without a finite number; torques and commands may be empty throughout."""
    needed = ["time_s", "trial", *(f"position.{joint}" for joint in robot.joints)]
    optional = [f"torque.{joint}" for joint in robot.joints]
    optional += [f"command.{actuator}" for actuator in robot.actuators]
    for name in (*needed, *optional):
        gaps = np.flatnonzero(~np.isfinite(table.get(name, np.zeros(0))))
        if gaps.size and (name in needed or not np.isnan(table[name]).all()):
            remedy = "" if name in needed else ", or leave the column out"
            raise RecordingError(
                f"{path}: row {gaps[0] + 1}, column {name}: empty or not finite; fill every "
                f"row{remedy}"
            )


def _trials(
    parts: Sequence[dict[str, Array]], tables: Sequence[dict[str, Array]]
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """By column, by file, or by pauses; cut into stretches where there are too few."""
    numbers: list[NDArray[np.int64]] = []
    begin = 0
    how = "by their column" if all("trial" in table for table in tables) else "by file and pause"
    for part, table in zip(parts, tables, strict=True):
        if "trial" in table:
            own = np.unique(table["trial"], return_inverse=True)[1]
        else:
            own = _by_pauses(part["time_s"], part["position"])
        numbers.append(begin + own.astype(np.int64))
        begin = int(numbers[-1].max()) + 1
    trial = np.concatenate(numbers)
    count = int(trial.max()) + 1
    if count < FEWEST_TRIALS:
        trial = _cut(np.concatenate([part["time_s"] for part in parts]), trial)
        how += f", {count} in all, cut into {int(trial.max()) + 1} stretches"
    return trial, (f"Trials {how}.",)


def _by_pauses(time_s: Array, position: Array) -> NDArray[np.int64]:
    """A trial begins in the middle of each rest of all joints, and where time has a gap."""
    interval = np.diff(time_s, prepend=time_s[0])
    typical = float(np.median(interval[1:]))
    window = max(1, round(0.1 / max(typical, 1e-6)))
    moved = np.abs(position[window:] - position[:-window])
    far = np.zeros(len(time_s), dtype=bool)
    far[: len(moved)] = (moved > _STILL_SHARE * moved.max(0, initial=0.0) + 1e-9).any(1)
    begins = np.flatnonzero(interval > max(5.0 * typical, _STILL_S))
    edges = np.flatnonzero(np.diff(far.astype(int), prepend=1, append=1))
    rests = [
        (a + b) // 2
        for a, b in zip(edges[::2], edges[1::2], strict=False)
        if time_s[min(b, len(time_s) - 1)] - time_s[a] >= _STILL_S and a > 0 and b < len(time_s)
    ]
    marks = np.zeros(len(time_s), dtype=np.int64)
    marks[[*begins, *rests]] = 1
    return np.cumsum(marks)


def _cut(time_s: Array, trial: NDArray[np.int64]) -> NDArray[np.int64]:
    """Trials cut into stretches, ten in all where they are long enough."""
    spans = [np.ptp(time_s[trial == t]) for t in np.unique(trial)]
    stretch_s = max(_LEAST_STRETCH_S, min(sum(spans) / (2 * FEWEST_TRIALS), _MOST_STRETCH_S))
    cut, begin = np.zeros_like(trial), 0
    for t, span in zip(np.unique(trial), spans, strict=True):
        rows = trial == t
        pieces = max(1, int(span / stretch_s))
        since = (time_s[rows] - time_s[rows][0]) / max(span, 1e-9)
        cut[rows] = begin + np.minimum((since * pieces).astype(int), pieces - 1)
        begin += pieces
    return cut


def _check(path: Path, robot: Robot, every: dict[str, Array], trial: NDArray[np.int64]) -> None:
    interval = np.diff(every["time_s"])[np.diff(trial) == 0]
    if (interval <= 0.0).any():
        row = int(np.flatnonzero((np.diff(every["time_s"]) <= 0.0) & (np.diff(trial) == 0))[0]) + 2
        raise RecordingError(f"{path}: row {row}: time stands still or runs back within a trial")
    typical = float(np.median(interval))
    if typical > _MOST_INTERVAL_S:
        raise RecordingError(
            f"{path}: rows are {typical:g} s apart; time_s must be in seconds (milliseconds "
            "given?)"
        )
    hinges = np.array([unit == "rad" for unit in robot.position_units])
    largest = np.abs(every["position"][:, hinges]).max(initial=0.0)
    if largest > _MOST_RAD:
        raise RecordingError(
            f"{path}: positions reach {largest:.0f}; they must be in rad (degrees given?)"
        )
    moved = np.ptp(every["position"], axis=0)
    if moved.max(initial=0.0) <= 0.0:
        raise RecordingError(f"{path}: no joint moves; a recording of motion is right")
