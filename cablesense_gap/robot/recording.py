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
from cablesense_gap.robot.model import Robot
from cablesense_msgs_py.qos import JOINT_STATE_TYPE, NUMBER_TYPE
from cablesense_recording.csv_file import CSV_ENDINGS, csv_stem, read_table
from cablesense_recording.mcap_file import decoded, is_bag
from cablesense_recording.mcap_messages import RawMessage
from cablesense_recording.recording import MAX_NUMBERS, RecordingError

FEWEST_TRIALS = 5
"""Fewer are cut into stretches, so that there is something to hold out."""

_NUMBERS_TYPE = "std_msgs/msg/Float64MultiArray"
_PREFIXES = ("time", "trial", "position.", "torque.", "command.")
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
        tables = {path: bag_table(path, robot)}
    else:
        tables = {file: read_table(file, _PREFIXES) for file in _files(path)}
    parts = [_part(file, table, robot) for file, table in tables.items()]
    trials, note = _trials(parts, list(tables.values()))
    name = path.name if path.is_dir() else csv_stem(path)
    arrays = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    _check(path, robot, arrays, trials)
    return RobotRecording(name, trial=trials, notes=(note,), **arrays)


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

    joints = robot.joints
    actuators = robot.actuators
    # a plain array, as objects take four times the memory
    values = array("d")
    names = set[str]()
    states = ""
    trial = np.nan
    command = np.full(len(actuators), np.nan)
    for raw, message in decoded(path, wanted):
        commands = "command" in raw.topic
        if hasattr(message, "data"):
            if raw.topic.rpartition("/")[2] == "trial" and np.ndim(message.data) == 0:
                trial = float(message.data)
            elif commands and np.shape(message.data) == command.shape:
                command = np.asarray(message.data, dtype=float)
            continue
        names |= set(message.name)
        if commands and actuators and set(actuators) <= set(message.name):
            commanded = message.effort if len(message.effort) else message.position
            ordered = _in_order(message.name, commanded, actuators)
            command = command if ordered is None else ordered
            continue
        position = _in_order(message.name, message.position, joints)
        states = states or (raw.topic if position is not None else "")
        if position is None or raw.topic != states:  # the first topic of the robot's states counts
            continue
        torque = _in_order(message.name, message.effort, joints)
        torque = np.full(len(joints), np.nan) if torque is None else torque
        stamp_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        values.extend((stamp_s or 1e-9 * raw.log_ns, trial, *position, *torque, *command))
        if len(values) > MAX_NUMBERS:
            raise RecordingError(f"{path}: more than {MAX_NUMBERS} numbers; split it")
    if not values:
        raise RecordingError(
            f"{path}: holds no {JOINT_STATE_TYPE} with the joints {some_of(joints)}; it names "
            f"{some_of(sorted(names)) or 'none'}"
        )
    labels = ["time_s", "trial"]
    labels += [f"{kind}.{joint}" for kind in ("position", "torque") for joint in joints]
    labels += [f"command.{name}" for name in actuators]
    rows = np.array(values).reshape(-1, len(labels))
    _, torque, command = np.split(rows[:, 2:], [len(joints), 2 * len(joints)], axis=1)
    if not np.isfinite(torque).any():  # commands drive the model, and are not known before
        rows = rows[np.isfinite(command).all(axis=1).argmax() :]
    table = dict(zip(labels, rows.T, strict=True))
    table["time_s"] = table["time_s"] - table["time_s"][0]
    numbered = np.isfinite(table["trial"])
    if numbered.any():
        table["trial"] = np.where(numbered, table["trial"], np.nanmin(table["trial"]) - 1.0)
    else:
        del table["trial"]
    return table


def _in_order(names: Sequence[str], values: Any, wanted: Sequence[str]) -> Array | None:
    """Values of the wanted names; none unless all are there, with one value for each name."""
    if len(values) != len(names) or not set(wanted) <= set(names):
        return None
    position_of = {name: k for k, name in enumerate(names)}
    return np.asarray(values, dtype=float)[[position_of[name] for name in wanted]]


def _part(path: Path, table: dict[str, Array], robot: Robot) -> dict[str, Array]:
    """Arrays of one file by the names of `RobotRecording`."""
    if "time_s" not in table:
        near = [name for name in table if "time" in name.lower()]
        hint = f"; {near[0]} is there: it must be time_s, in seconds" if near else ""
        raise RecordingError(f"{path}: misses column time_s{hint}")
    rows = len(table["time_s"])
    if rows < 2:
        raise RecordingError(f"{path}: has {rows} rows; a recording of motion has thousands")
    names = {"position": robot.joints, "torque": robot.joints, "command": robot.actuators}
    labels = {
        kind: [f"{kind}.{name}" for name in kind_names] for kind, kind_names in names.items()
    }
    known = [label for kind_labels in labels.values() for label in kind_labels]
    _refuse_other_names(path, table, robot, set(known))
    for name in filter(table.__contains__, ("time_s", "trial", *known)):
        gaps = np.flatnonzero(~np.isfinite(table[name]))
        optional = name in (*labels["torque"], *labels["command"])
        if gaps.size and not (optional and np.isnan(table[name]).all()):
            remedy = ", or leave the column out" if optional else ""
            raise RecordingError(
                f"{path}: row {gaps[0] + 1}, column {name}: empty or not finite; fill every "
                f"row{remedy}"
            )

    def stacked(own: Sequence[str]) -> Array:
        columns = [table.get(label, np.full(rows, np.nan)) for label in own]
        return np.ascontiguousarray(np.array(columns).reshape(len(own), rows).T)

    return {
        "time_s": table["time_s"],
        **{kind: stacked(kind_labels) for kind, kind_labels in labels.items()},
    }


def _refuse_other_names(
    path: Path, table: dict[str, Array], robot: Robot, known: set[str]
) -> None:
    """Joints and actuators of another robot; joints without a position."""
    missing = [j for j in robot.joints if f"position.{j}" not in table]
    others = [name for name in table if "." in name and name not in known]
    surplus = sorted({name.partition(".")[2] for name in others})
    defects = [f"misses the position of {some_of(missing)}"] if missing else []
    defects += [f"has {some_of(surplus)}, which the model has not"] if surplus else []
    if defects:
        raise RecordingError(
            f"{path}: {' and '.join(defects)}; {robot.path.name} has the joints "
            f"{some_of(robot.joints, 12)}"
            + (f" and the actuators {some_of(robot.actuators, 12)}" if robot.actuators else "")
        )


def _trials(
    parts: Sequence[dict[str, Array]], tables: Sequence[dict[str, Array]]
) -> tuple[NDArray[np.int64], str]:
    """By column, by file, or by pauses; cut into stretches where there are too few."""
    trials: list[NDArray[np.int64]] = []
    begin = 0
    how = "by their column" if all("trial" in table for table in tables) else "by file and pause"
    for part, table in zip(parts, tables, strict=True):
        if "trial" in table:
            file_trials = np.unique(table["trial"], return_inverse=True)[1]
        else:
            file_trials = _by_pauses(part["time_s"], part["position"])
        trials.append(begin + file_trials)
        begin = int(trials[-1].max()) + 1
    trial = np.concatenate(trials)
    if begin < FEWEST_TRIALS:
        trial = _cut(np.concatenate([part["time_s"] for part in parts]), trial)
        how += f", {begin} in all, cut into {int(trial.max()) + 1} stretches"
    return trial, f"Trials {how}."


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
    cut = np.zeros_like(trial)
    begin = 0
    for t, span in zip(np.unique(trial), spans, strict=True):
        rows = trial == t
        pieces = max(1, int(span / stretch_s))
        since = (time_s[rows] - time_s[rows][0]) / max(span, 1e-9)
        cut[rows] = begin + np.minimum((since * pieces).astype(int), pieces - 1)
        begin += pieces
    return cut


def _check(path: Path, robot: Robot, every: dict[str, Array], trial: NDArray[np.int64]) -> None:
    interval = np.diff(every["time_s"])
    within = np.diff(trial) == 0
    back = np.flatnonzero((interval <= 0.0) & within)
    if back.size:
        raise RecordingError(
            f"{path}: row {back[0] + 2}: time stands still or runs back within a trial"
        )
    typical = float(np.median(interval[within]))
    step = np.abs(np.diff(every["position"], axis=0)[within])
    speed = (step / interval[within, None]).max(0, initial=0.0)
    if typical > _MOST_INTERVAL_S and speed.max() < _LEAST_SPEED:
        raise RecordingError(
            f"{path}: rows are {typical:g} s apart and joints reach {speed.max():.2g} in 1 s; "
            "time_s must be in seconds (milliseconds given?)"
        )
    hinges = np.array([unit == "rad" for unit in robot.position_units])
    hinges &= robot.model.jnt_limited.astype(bool) | (speed > _MOST_RAD_S)
    largest = np.abs(every["position"][:, hinges]).max(initial=0.0)
    if largest > _MOST_RAD:
        raise RecordingError(
            f"{path}: positions reach {largest:.0f}; they must be in rad (degrees given?)"
        )
    moved = np.ptp(every["position"], axis=0)
    if moved.max(initial=0.0) <= 0.0:
        raise RecordingError(f"{path}: no joint moves; a recording of motion is right")
