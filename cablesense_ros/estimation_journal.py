"""What changes between samples, told with the whole state before the next one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from cablesense_msgs_py.contract_error import ContractError
from cablesense_msgs_py.journal import Event, EventKind, JournalEntry
from cablesense_ros.estimation_settings import EstimationSettings
from cablesense_ros.motion_gate import MotionGate
from cablesense_ros.tare import TareModel
from cablesense_sim.arm import Arm

Array = NDArray[np.float64]


class EstimationJournal:
    """Keeps the events since the last entry, and makes the next one of an arm.

    Attributes:
        arm_identity: of that arm.
    """

    def __init__(self, arm: Arm, described: Mapping[str, str]) -> None:
        """`described` goes into each entry beside the settings."""
        self.arm_identity = arm.identity
        self._joint_count, self._cable_count = arm.joint_count, arm.cable_count
        self._described = {**described, "joints": " ".join(arm.joint_names)}
        self._events: list[Event] = []

    def start(self, command_rad: Array) -> None:
        """Samples begin at a command (2N,); told once, however often before the first sample."""
        event = Event(EventKind.START, tuple(command_rad.tolist()))
        if event not in self._events:
            self._events.append(event)

    def note(self, kind: EventKind) -> None:
        """Something has changed that the state shows."""
        self._events.append(Event(kind))

    def command(self, command_rad: Array) -> None:
        """Another command (2N,) counts."""
        self._events.append(Event(EventKind.COMMAND, tuple(command_rad.tolist())))

    def forget(self) -> None:
        """Events until now are those of another journal."""
        self._events.clear()

    def next_entry(
        self,
        before_ns: int,
        settings: EstimationSettings,
        command_rad: Array,
        gate: MotionGate,
        tare: TareModel,
    ) -> JournalEntry | None:
        """What counts from the sample stamped `before_ns` on; none where nothing has changed."""
        if not self._events:
            return None
        events, self._events = tuple(self._events), []
        present, unloaded = tare.present, tare.unloaded_n
        lowest, highest = gate.range_rad
        return JournalEntry(
            before_ns=before_ns,
            events=events,
            arm=self.arm_identity,
            settings={
                **self._described,
                **{name: repr(value) for name, value in asdict(settings).items()},
            },
            command_rad=tuple(command_rad.tolist()),
            lowest_rad=tuple(lowest.tolist()),
            highest_rad=tuple(highest.tolist()),
            rest_from_ns=gate.rest_from_ns,
            unloaded_n=() if unloaded is None else tuple(unloaded.tolist()),
            tared_n=() if present is None else tuple(present.measured_n.tolist()),
            tare_command_rad=() if present is None else tuple(present.command_rad.tolist()),
        )

    def require_fitting(self, entry: JournalEntry) -> None:
        """Refuse an entry that this arm cannot go on from.

        Raises:
            ContractError: the entry is of an arm with other joints or cables.
        """
        joints, cables = self._joint_count, self._cable_count
        lengths = {"joint angles": (entry.command_rad, joints)}
        lengths["lowest joint angles"] = (entry.lowest_rad, joints)
        lengths["highest joint angles"] = (entry.highest_rad, joints)
        if entry.tared_n:
            lengths["joint angles at the tare"] = (entry.tare_command_rad, joints)
            lengths["tared tensions"] = (entry.tared_n, cables)
            lengths["unloaded tensions"] = (entry.unloaded_n, cables)
        for what, (numbers, wanted) in lengths.items():
            if len(numbers) != wanted:
                raise ContractError(
                    f"journal: {len(numbers)} {what}; the arm {self.arm_identity} has {wanted}"
                )
