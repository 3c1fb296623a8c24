"""A robot's recording as MCAP or rosbag2: `sensor_msgs/JointState`, whatever its topic."""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import Any

import numpy as np

from cablesense_base import Array, CableSenseError, some_of
from cablesense_gap.recordings.mcap_file import raw_messages
from cablesense_gap.recordings.mcap_messages import BagTypes
from cablesense_gap.recordings.recording import MAX_NUMBERS, RecordingError
from cablesense_gap.robot.model import Robot
from cablesense_msgs_py.qos import JOINT_STATE_TYPE, NUMBER_TYPE
from cablesense_msgs_py.serialized import require_bounded
from cablesense_msgs_py.topics import ContractError

_TRIAL = "trial"
_NUMBERS_TYPE = "std_msgs/msg/Float64MultiArray"


def bag_table(path: Path, robot: Robot) -> dict[str, Array]:
    """Columns of a recording, as a CSV has them, one row a joint state of all the robot's joints.

    Positions, velocities and efforts come from the joint states; commands from a topic whose joint
    states name the actuators, or whose numbers are as many as the actuators and whose name has
    `command` in it, the latest before each row; trials from a topic `trial`, a trial of its own
    before the first number. Without efforts rows begin with the first command.

    Raises:
        RecordingError: no bag, one too large, or no joint states with the robot's joints.
    """
    types, rows = BagTypes(), _Rows(robot)
    try:
        for raw in raw_messages(path):
            if raw.kind not in (JOINT_STATE_TYPE, NUMBER_TYPE, _NUMBERS_TYPE):
                continue
            try:
                require_bounded(raw.data)
            except ContractError as error:
                raise RecordingError(f"{path}: {raw.topic}: {error}") from error
            rows.take(raw.topic, raw.log_ns, types.message(raw.kind, raw.data))
            if rows.numbers > MAX_NUMBERS:
                raise RecordingError(f"{path}: more than {MAX_NUMBERS} numbers; split it")
    except CableSenseError:
        raise
    except Exception as error:  # a broken file raises anything in a parser
        line = " ".join(str(error).split())[:200] or type(error).__name__
        raise RecordingError(f"{path}: cannot be read as rosbag2 ({line})") from error
    return rows.table(path)


class _Rows:
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
        """One message; those that are not of this robot are passed over."""
        if hasattr(message, "data"):
            self._take_numbers(topic, message.data)
            return
        at = {name: k for k, name in enumerate(message.name)}
        self._names |= set(at)
        if "command" in topic and self._robot.actuators and set(self._robot.actuators) <= set(at):
            wanted = [at[name] for name in self._robot.actuators]
            given = next((f for f in (message.effort, message.position) if len(f)), ())
            if len(given) == len(at):
                self._command = np.asarray(given, dtype=float)[wanted]
            return
        if not set(self._robot.joints) <= set(at) or len(message.position) != len(at):
            return
        self._topic = self._topic or topic
        if topic != self._topic:
            return
        wanted = [at[name] for name in self._robot.joints]
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self._values.extend((stamp or 1e-9 * log_ns, self._trial))
        for values in (message.position, message.effort):
            known = len(values) == len(at)
            own = (
                np.asarray(values, dtype=float)[wanted] if known else np.full(len(wanted), np.nan)
            )
            self._values.extend(own)
        self._values.extend(self._command)

    def _take_numbers(self, topic: str, data: Any) -> None:
        if topic.rpartition("/")[2] == _TRIAL and np.ndim(data) == 0:
            self._trial = float(data)
        elif "command" in topic and np.shape(data) == self._command.shape:
            self._command = np.asarray(data, dtype=float)

    def table(self, path: Path) -> dict[str, Array]:
        """All rows, time from the first."""
        robot = self._robot
        labels = ["time_s", _TRIAL]
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
        numbered = np.isfinite(table[_TRIAL])
        if numbered.any():
            table[_TRIAL] = np.where(numbered, table[_TRIAL], np.nanmin(table[_TRIAL]) - 1.0)
        else:
            del table[_TRIAL]
        return table
