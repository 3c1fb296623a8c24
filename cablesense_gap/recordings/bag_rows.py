"""Rows of a recording from messages as they come: tensions, with the command and load in force."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.recording import Recording
from cablesense_gap.recordings.recording_error import RecordingError
from cablesense_gap.recordings.trials import derive_trials
from cablesense_msgs_py import topics
from cablesense_msgs_py.frames import Frames
from cablesense_msgs_py.joint_state import joint_command_rad
from cablesense_msgs_py.load import read_load
from cablesense_msgs_py.named_values import NamedOrder
from cablesense_sim.arm import Arm

Array = NDArray[np.float64]

MAX_ROWS = 10_800_000
"""A packed file holds any number of equal messages; rows of them take some 500 bytes each."""


class BagRows:
    """Takes messages in the order they came, and gives the recording they make.

    With `keep` false it only says whether messages keep the contract.
    """

    def __init__(self, arm: Arm, keep: bool = True) -> None:
        self._arm = arm
        self._keep = keep
        self._cables = NamedOrder(arm.cable_names, "cables")
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._taken: Counter[str] = Counter()
        self._command: Array | None = None
        self._loads: dict[int, Array] = {}
        self._trial: int | None = None
        self._stamps_ns: list[tuple[int, int]] = []
        self._commands: list[Array] = []
        self._segments: list[int] = []
        self._forces: list[Array] = []
        self._tensions: list[Array] = []
        self._trials: list[int | None] = []

    @property
    def has_commands(self) -> bool:
        """Whether any command came."""
        return self._command is not None

    @property
    def count(self) -> int:
        """Rows so far."""
        return len(self._tensions)

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
            self._command = joint_command_rad(message, self._joints)
        elif topic == topics.APPLIED_WRENCH:
            self._take_load(message)
        elif topic == topics.TRIAL:
            self._trial = int(message.data)
        elif self._command is not None:
            self._take_tensions(log_ns, message, self._command)

    def recording(self, name: str) -> Recording:
        """All rows, time from the first."""
        stamps = np.array(self._stamps_ns, dtype=np.int64).reshape(-1, 2)
        # a clock that stamps only some messages is none
        clock_ns = stamps[:, 1] if (stamps[:, 1] != 0).all() else stamps[:, 0]
        time_s: Array = (clock_ns - clock_ns[:1]).astype(np.float64) * 1e-9
        command = np.array(self._commands).reshape(-1, self._arm.joint_count)
        segment = np.array(self._segments, dtype=np.int64)
        load_n = np.array(self._forces).reshape(-1, 3)
        first = next((trial for trial in self._trials if trial is not None), None)
        if first is None:
            trial = derive_trials(time_s, command, segment, load_n)
        else:
            named = [first if number is None else number for number in self._trials]
            trial = np.array(named, dtype=np.int64)
        return Recording(
            name=name,
            time_s=time_s,
            trial=trial,
            command_rad=command,
            load_segment=segment,
            load_n=load_n,
            tensions_n=np.array(self._tensions).reshape(-1, self._arm.cable_count),
        )

    def _take_load(self, message: Any) -> None:
        prefix = message.header.frame_id.rpartition("segment_")[0]
        load = read_load(message, Frames(self._arm.segment_count, prefix))
        self._loads.pop(load.segment, None)
        if load.force_base_n.any():
            self._loads[load.segment] = load.force_base_n

    def _take_tensions(self, log_ns: int, message: Any, command: Array) -> None:
        if len(self._loads) > 1:
            raise RecordingError(
                f"segments {' and '.join(map(str, sorted(self._loads)))} are loaded at once; take "
                "one load off (a zero force in its frame) before putting on the next"
            )
        segment, force = next(iter(self._loads.items()), (0, np.zeros(3)))
        tensions = self._cables.arrange(message.name, message.effort, "effort")
        if not self._keep:
            return
        if len(self._tensions) >= MAX_ROWS:
            raise RecordingError(
                f"more than {MAX_ROWS} samples; three hours at 1 kHz are as many: split it"
            )
        stamp = message.header.stamp
        self._tensions.append(tensions)
        self._stamps_ns.append((log_ns, stamp.sec * 1_000_000_000 + stamp.nanosec))
        self._commands.append(command)
        self._segments.append(segment)
        self._forces.append(force)
        self._trials.append(self._trial)
