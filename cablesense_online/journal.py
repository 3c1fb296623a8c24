"""What changes between samples, told with the whole state before the next one.

Models that remember go through what a journal tells, and so come to the same past.

What an estimator's answers rest on, kept in a file: one that was killed goes on from there.

Without it an estimator that comes back beside a loaded arm would take the load for the unloaded
state (`auto_tare`), and be blind to it from then on.

What the estimator is told beside its arm and its model.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from cablesense_base.arrays import Array
from cablesense_base.errors import CableSenseError
from cablesense_base.files import read_bounded_text, write_atomically
from cablesense_msgs_py.journal import MOST_NUMBERS, Event, EventKind, JournalEntry
from cablesense_msgs_py.topics import ContractError
from cablesense_online.answers import Answers
from cablesense_online.motion_gate import MotionGate
from cablesense_online.tare import TareModel
from cablesense_sim.arm import Arm


@dataclass(frozen=True)
class EstimationSettings:
    """As the node's parameters of the same names say."""

    contact_threshold: float
    stale_after_s: float
    slack_below_n: float
    tare_samples: int
    tare_steady_n: float
    auto_tare: bool
    joint_speed_rad_s: float
    settle_s: float


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


TARES = frozenset({EventKind.TARE, EventKind.AUTO_TARE, EventKind.TARE_UNDO})


class JournalFollower:
    """Tells the events of one entry after the other to what answers."""

    def __init__(self, answers: Answers) -> None:
        self._answers = answers
        self._started = False

    @property
    def vouches(self) -> bool:
        """Whether what answers has the past that the journal speaks of.

        A model with memory has one from a start on.
        """
        return self._started or not self._answers.in_motion

    def follow(self, entry: JournalEntry) -> None:
        """Let what answers be where the entry was made, from its own past where it has one.

        Raises:
            CableSenseError: a command of the entry is of a pose that this arm cannot take.
        """
        if not self._started:
            self._answers.restore(np.array(entry.command_rad))
        for event in entry.events:
            if event.kind is EventKind.START and event.command_rad:
                self._answers.restore(np.array(event.command_rad))
            elif event.kind is EventKind.COMMAND:
                self._answers.command(np.array(event.command_rad))
            elif event.kind in TARES:
                self._answers.begin()
            self._started |= event.kind is EventKind.START


FORMAT: Final = "cablesense estimator state 1"
MAX_BYTES: Final = 200_000
SIGN_OF_LIFE_S: Final = 1.0
"""So often the file's time is renewed: it says when its estimator was last alive."""

_BEYOND: Final = 1e9
"""No angle in rad and no tension in N is so large; whole numbers may, and be no float."""

_NUMBERS: Final = (
    "command_rad",
    "lowest_rad",
    "highest_rad",
    "unloaded_n",
    "tared_n",
    "tare_command_rad",
)


class StateFileError(CableSenseError):
    """A state file that cannot be gone on from, or not be written: says why."""


class StateFile:
    """The latest journal entry of one estimator in a file.

    An entry is kept in memory and written by the next `flush`, so that no sample waits for a disk.
    """

    def __init__(
        self, path: str | Path, within_s: float, now_s: Callable[[], float] = time.time
    ) -> None:
        """`path` empty keeps nothing; a state older than `within_s` is not gone on from."""
        self._path = Path(path) if str(path) else None
        self._within_s = within_s
        self._now_s = now_s
        self._pending: JournalEntry | None = None
        self._kept = False
        self._alive_s = float("-inf")

    def read(self, arm_identity: str) -> JournalEntry | None:
        """The state of an estimator of the same arm that was alive a moment ago; None without one.

        Raises:
            StateFileError: there is a file, and it cannot be gone on from.
        """
        if self._path is None or not self._path.exists():
            return None
        age_s = self._now_s() - self._path.stat().st_mtime
        if not -self._within_s <= age_s <= self._within_s:
            raise StateFileError(
                f"{self._path}: its estimator was last alive {age_s:.0f} s ago, and at most "
                f"{self._within_s:g} s is gone on from"
            )
        entry = _entry(read_bounded_text(self._path, MAX_BYTES, "a state file", StateFileError))
        if entry is None:
            raise StateFileError(f"{self._path}: is no state of an estimator ({FORMAT})")
        if entry.arm != arm_identity:
            raise StateFileError(
                f"{self._path}: is of arm {entry.arm[:80]!r}; this is {arm_identity}"
            )
        if not entry.tared_n:
            raise StateFileError(f"{self._path}: its estimator had no tare")
        self._kept = True
        return entry

    def keep(self, entry: JournalEntry) -> None:
        """Take note of what answers rest on from now on."""
        self._pending = entry

    def flush(self) -> None:
        """Write what was noted, or renew the file's time.

        Raises:
            StateFileError: it cannot be written.
        """
        if self._path is None:
            return
        now_s = self._now_s()
        try:
            if self._pending is not None:
                _write(self._path, self._pending)
                self._pending, self._kept, self._alive_s = None, True, now_s
            elif self._kept and not 0.0 <= now_s - self._alive_s < SIGN_OF_LIFE_S:
                self._alive_s = now_s
                os.utime(self._path)
        except OSError as error:
            raise StateFileError(
                f"{self._path}: cannot be written ({error.strerror or error})"
            ) from error


def _write(path: Path, entry: JournalEntry) -> None:
    values = asdict(entry)
    del values["events"]
    write_atomically(path, json.dumps({"format": FORMAT, **values}, indent=1), StateFileError)


def _entry(text: str) -> JournalEntry | None:
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(values, Mapping) or values.get("format") != FORMAT:
        return None
    numbers = {name: _numbers(values.get(name)) for name in _NUMBERS}
    arm, before_ns, rest_from_ns = (
        values.get(name) for name in ("arm", "before_ns", "rest_from_ns")
    )
    if None in numbers.values() or not (
        isinstance(arm, str) and isinstance(before_ns, int) and isinstance(rest_from_ns, int)
    ):
        return None
    return JournalEntry(
        before_ns=before_ns,
        events=(),
        arm=arm,
        settings={},
        rest_from_ns=rest_from_ns,
        **numbers,  # type: ignore[arg-type]  # none is None
    )


def _numbers(given: Any) -> tuple[float, ...] | None:
    if not isinstance(given, list) or len(given) > MOST_NUMBERS:
        return None
    if not all(type(one) in (int, float) and abs(one) < _BEYOND for one in given):
        return None
    return tuple(float(one) for one in given)
