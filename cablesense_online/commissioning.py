"""The commissioning: an unloaded machine goes from pose to pose, until it is known.

In each pose it waits for rest, averages readings, and adds them to its calibration
(`cablesense_contact.calibration`). Cables slide as they reach a pose, and friction leaves them
with tensions of the side that they came from; so poses are reached from two sides in turn, and
each from both sides where the machine's file states friction.

Here is what to do when; who calls has the clock, sends the commands, and hands over the readings.
All times are of one clock, that of the readings' stamps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_contact.calibration import CalibrationError, Calibrator, Unloaded
from cablesense_contact.felt import torque_covariance_at_rest
from cablesense_contact.judgement import ContactState, Judge
from cablesense_contact.law import Law, LawOutput
from cablesense_contact.reference_contacts import KnownForce
from cablesense_online.chosen_poses import READINGS
from cablesense_online.movable import Movable, taut
from cablesense_sim.joint_motion import JointMotion, move_duration_s

_TOUCHED_PROBABILITY = 0.999
"""A reading stops the motion if a contact is so probable."""
_CONFIRMED = 2
"""Means in turn that must show it."""
_DEAF_SHARE = 0.5
"""Of the time without a reading that ends it: where so much passes between two calls, the silence
is the caller's own."""
_UNSTEADY_STD = 6.0
"""A reading so many deviations from the mean before it is not of an arm at rest."""
_FEWEST_STEADY = 5
"""Readings in a hold from which its noise is told."""
_AVERAGED_S = 0.2
"""Readings are averaged over at least this time: an arm on cables swings with 5 to 20 Hz."""
_LONGEST_HOLD = 3.0
"""A hold takes at most this multiple of its time, and `_HOLD_MARGIN_S` more."""
_HOLD_MARGIN_S = 5.0
"""How long a hold may take beyond that: sensors may pause."""
_NS = 1_000_000_000
"""Nanoseconds of a second."""


class CommissioningRefusedError(CableSenseError):
    """A commissioning that cannot begin; says why, and what would be right."""


class Stage(Enum):
    """What the arm does."""

    APPROACHING = "on the way to a pose"
    ARRIVING = "arriving"
    HOLDING = "at rest"
    RETURNING = "on the way back"
    DONE = "done"
    STOPPED = "stopped"


@dataclass(frozen=True)
class CommissioningSettings:
    """How a commissioning goes.

    Attributes:
        joint_speed_rad_s: peak speed at which the machine approaches a command by itself; a move
            is waited for as long as that takes.
        settle_s: waited after a move, until the arm is at rest.
        readings: averaged in each pose; of fast sensors those of 0.2 s.
        approach_rad: how far beyond a pose a joint turns first, to reach it from a certain side;
            it must move the cables farther than their friction stretches them.
        both_sides: whether every pose is held twice; None where the file states friction.
        silent_after_s: without a reading for this long the motion stops.
    """

    joint_speed_rad_s: float = float(np.deg2rad(20.0))
    settle_s: float = 0.5
    readings: int = READINGS
    approach_rad: float = float(np.deg2rad(1.0))
    both_sides: bool | None = None
    silent_after_s: float = 1.0

    def readings_at(self, rate_hz: float) -> int:
        """How many readings a hold takes at a rate."""
        return max(self.readings, math.ceil(_AVERAGED_S * rate_hz))

    def hold_s(self, rate_hz: float) -> float:
        """How long a hold takes at a rate."""
        return self.settle_s + self.readings_at(rate_hz) / rate_hz


class Visit(NamedTuple):
    """One hold: by way of a command beside it (C,), at a command (C,)."""

    beside_rad: Array
    pose_rad: Array


class Progress(NamedTuple):
    """How far a commissioning has come.

    Attributes:
        holds_done, holds: in all.
        remaining_s: until it has returned.
        known_force: how well a push is known now (`ReferenceContacts`).
        text: of these, in words.
    """

    holds_done: int
    holds: int
    remaining_s: float
    known_force: KnownForce

    @property
    def text(self) -> str:
        """All of it as a sentence."""
        return (
            f"{self.holds_done} of {self.holds} holds, about {self.remaining_s:.0f} s left; "
            f"{self.known_force.text}"
        )


def visits(movable: Movable, poses_rad: Array, settings: CommissioningSettings) -> list[Visit]:
    """What is visited at commands (K, C): from two sides in turn, or each from both."""
    both_sides = settings.both_sides
    if both_sides is None:
        both_sides = movable.rubs
    beside_rad = movable.beside(settings.approach_rad)
    stops = []
    for number, pose_rad in enumerate(poses_rad):
        side = -1.0 if number % 2 else 1.0
        stops.append(Visit(pose_rad + side * beside_rad, pose_rad))
        if both_sides:
            stops.append(Visit(pose_rad - side * beside_rad, pose_rad))
    return stops


def expected_duration_s(
    stops: Sequence[Visit],
    settings: CommissioningSettings,
    start_rad: Array,
    rate_hz: float,
    speed: float,
) -> float:
    """How long visits take, from a command (C,) and back to it.

    Readings come at a rate; commands change by `speed` a second at most.
    """
    way = [start_rad]
    for visit in stops:
        way += [visit.beside_rad, visit.pose_rad]
    way.append(start_rad)
    moving_s = sum(
        move_duration_s(float(np.abs(to_rad - from_rad).max()), speed)
        for from_rad, to_rad in pairwise(way)
    )
    return moving_s + len(stops) * settings.hold_s(rate_hz)


class _Readings:
    """Readings (M,) with their times."""

    def __init__(self) -> None:
        self._readings_n: list[Array] = []
        self._begun_ns = 0
        self._ended_ns = 0

    def __len__(self) -> int:
        return len(self._readings_n)

    def clear(self) -> None:
        """Begin anew."""
        self._readings_n.clear()

    def add(self, reading_n: Array, stamp_ns: int) -> None:
        """Add the next one."""
        if not self._readings_n:
            self._begun_ns = stamp_ns
        self._ended_ns = stamp_ns
        self._readings_n.append(reading_n)

    @property
    def span_s(self) -> float:
        """From the first to the last."""
        return (self._ended_ns - self._begun_ns) / _NS if self._readings_n else 0.0

    @property
    def mean_n(self) -> Array:
        """(M,) their mean."""
        return np.asarray(np.mean(self._readings_n, axis=0))


class Commissioning:
    """One commissioning, from its first command to the calibration.

    Attributes:
        stage: what the arm does.
        problem: why it stopped; empty where it did not.
        skipped: holds left out, because a cable would be nearly slack there.
        calibration: by the holds so far.
        sent_rad: (C,) the last command.
    """

    def __init__(
        self,
        movable: Movable,
        law: Law,
        poses_rad: Array,
        start_rad: Array,
        now_ns: int,
        rate_hz: float,
        settings: CommissioningSettings | None = None,
    ) -> None:
        """Begin in poses at commands (K, C), with the machine at rest at a command (C,).

        Readings come at `rate_hz`.

        Raises:
            CommissioningRefusedError: there are no poses.
            CableSenseError: the machine does not bear the contacts by which it is judged.
        """
        if not len(poses_rad):
            raise CommissioningRefusedError("a commissioning needs at least one pose")
        felt = movable.felt
        self._movable = movable
        self._law = law
        self._settings = settings or CommissioningSettings()
        self._rate_hz = rate_hz
        self._speed = self._settings.joint_speed_rad_s * movable.per_radian
        self._calibrator = Calibrator(felt, law)
        self._judge = Judge(felt, _TOUCHED_PROBABILITY)
        self._contacts = movable.reference_contacts()
        self._covariance_at_rest = torque_covariance_at_rest(felt)
        self._unsteady_n = _UNSTEADY_STD * np.sqrt(felt.mean_variance(1))
        self._left = visits(movable, poses_rad, self._settings)
        self._holds = len(self._left)
        self._start_rad = start_rad
        self._motion = JointMotion.at_rest(start_rad, self._speed)
        self._moved_ns = now_ns
        self._heard_ns = now_ns
        self._passed_ns = now_ns
        # those of the hold that are averaged, and those since the last test for a touch
        self._steady = _Readings()
        self._since_test = _Readings()
        self._touches_in_turn = 0
        self._is_hold_done = False
        self._hold: Visit | None = None
        self._hold_from_ns = now_ns
        self.stage = Stage.HOLDING
        self.problem = ""
        self.skipped = 0
        self.calibration = self._calibrator.by_tolerances()
        # what the calibration says at the present pose, before its readings
        self._on_arrival = self.calibration
        self.sent_rad = start_rad
        self._due_rad: Array | None = None
        self._learn()
        self._next(now_ns)

    @property
    def over(self) -> bool:
        """Whether it is done, or has stopped."""
        return self.stage in (Stage.DONE, Stage.STOPPED)

    @property
    def progress(self) -> Progress:
        """How far it has come."""
        stops_left = list(self._left)
        if self._hold is not None and not self._is_hold_done:
            stops_left.insert(0, self._hold)
        here_rad = self._motion.target_rad
        remaining_s = 0.0
        if not self.over:
            remaining_s = expected_duration_s(
                stops_left, self._settings, here_rad, self._rate_hz, self._speed
            )
        return Progress(self._holds - len(stops_left), self._holds, remaining_s, self._known_force)

    def advance(self, now_ns: int) -> Array | None:
        """Let time pass; gives a command (C,) that is to be sent now."""
        if not self.over:
            self._pass(now_ns)
        due_rad = self._due_rad
        self._due_rad = None
        if due_rad is not None:
            self.sent_rad = due_rad
        return due_rad

    def take(self, reading_n: Array, stamp_ns: int) -> None:
        """Take a reading (M,) of a time; `advance` then gives what follows from it."""
        if self.over:
            return
        self._heard_ns = max(self._heard_ns, stamp_ns)
        if self.stage is not Stage.HOLDING or self._is_hold_done or stamp_ns < self._hold_from_ns:
            return
        self._since_test.add(reading_n, stamp_ns)
        if self._since_test.span_s >= _AVERAGED_S:
            mean_n = self._since_test.mean_n
            self._since_test.clear()
            if self._count_touch(mean_n, stamp_ns):
                return
        if self._is_unsteady(reading_n):
            self._steady.clear()
        self._steady.add(reading_n, stamp_ns)
        enough = len(self._steady) >= self._settings.readings
        if enough and self._steady.span_s >= _AVERAGED_S:
            self._add(stamp_ns)

    def stop(self, problem: str, now_ns: int) -> None:
        """End here, because of a problem; `advance` gives the command that holds the pose."""
        if self.over:
            return
        self._due_rad = self._motion.at((now_ns - self._moved_ns) / _NS).angle_rad.copy()
        self.stage = Stage.STOPPED
        self.problem = problem

    def give_way(self, problem: str) -> None:
        """End here without a command: someone else moves the arm."""
        self.stage = Stage.STOPPED
        self.problem = problem
        self._due_rad = None

    def _pass(self, now_ns: int) -> None:
        unheard_ns = now_ns - self._passed_ns
        self._passed_ns = now_ns
        if unheard_ns > _DEAF_SHARE * _NS * self._settings.silent_after_s:
            # what was computed took its time, and no reading could be taken meanwhile
            self._heard_ns = now_ns
        silent_s = (now_ns - self._heard_ns) / _NS
        if self._is_hold_done:
            self._is_hold_done = False
            self._next(now_ns)
        elif silent_s > self._settings.silent_after_s:
            self.stop(f"no reading for {silent_s:.1f} s", now_ns)
        elif self.stage is Stage.HOLDING:
            held_s = (now_ns - self._hold_from_ns) / _NS
            usual_s = self._settings.hold_s(self._rate_hz)
            if held_s > _LONGEST_HOLD * usual_s + _HOLD_MARGIN_S:
                self.stop(
                    f"no {self._settings.readings} steady readings in {held_s:.0f} s at rest: "
                    "does the arm swing, or do samples get lost?",
                    now_ns,
                )
        elif now_ns - self._moved_ns >= self._motion.remaining_s * _NS:
            self._arrived(now_ns)

    def _arrived(self, now_ns: int) -> None:
        if self.stage is Stage.RETURNING:
            self.stage = Stage.DONE
        elif self.stage is Stage.APPROACHING:
            assert self._hold is not None
            self._go_to(self._hold.pose_rad, Stage.ARRIVING, now_ns)
        else:
            self.stage = Stage.HOLDING
            self._hold_from_ns = now_ns + round(self._settings.settle_s * _NS)
            self._on_arrival = self._calibrator.moved(self.calibration)
            self._steady.clear()
            self._since_test.clear()
            self._touches_in_turn = 0

    def _next(self, now_ns: int) -> None:
        """Head for the next hold whose cables stay taut, or back."""
        while self._left:
            self._hold = self._left.pop(0)
            if taut(self._movable, self._hold.pose_rad[None], self.calibration)[0]:
                self._go_to(self._hold.beside_rad, Stage.APPROACHING, now_ns)
                return
            self.skipped += 1
        self._hold = None
        self._go_to(self._start_rad, Stage.RETURNING, now_ns)

    def _go_to(self, target_rad: Array, stage: Stage, now_ns: int) -> None:
        at_target = JointMotion.at_rest(self._motion.target_rad, self._speed)
        self._motion = at_target.towards(target_rad)
        self._moved_ns = now_ns
        self._due_rad = target_rad
        self.stage = stage

    def _count_touch(self, mean_n: Array, stamp_ns: int) -> bool:
        """Whether a mean (M,) shows a touch; one that is confirmed stops the motion.

        Readings before a touch are not averaged with those after it.
        """
        touch = self._touch(mean_n)
        if not touch:
            self._touches_in_turn = 0
            return False
        self._touches_in_turn += 1
        self._steady.clear()
        if self._touches_in_turn >= _CONFIRMED:
            self.stop(touch, stamp_ns)
        return True

    def _touch(self, mean_n: Array) -> str:
        """What a mean (M,) of readings shows that is not the untouched arm's, as a sentence.

        It is empty where nothing touches it. The probability of a contact decides, not the force
        that the sentence states, which may be small or known badly.
        """
        seen = self._seen(mean_n)
        judged = self._judge(seen, mean_n)
        if judged.state is ContactState.FREE:
            return ""
        if judged.doubt:
            return f"readings are not those of the untouched arm: {judged.doubt}"
        force_n = float(np.hypot(*seen.force_n[0, 1:]))
        link = self._movable.felt.link_names[judged.segment - 1].replace("_", " ")
        return f"something touches {link}, with about {force_n:.2g} N"

    def _seen(self, reading_n: Array) -> LawOutput:
        assert self._hold is not None
        return self._law(
            reading_n[None],
            self._hold.pose_rad[None],
            self._on_arrival.mean,
            self._on_arrival.covariance,
            self._covariance_at_rest,
        )

    def _is_unsteady(self, reading_n: Array) -> bool:
        """Whether a reading is far from the mean of those before it in this hold."""
        if len(self._steady) < _FEWEST_STEADY:
            return False
        off_n = np.abs(reading_n - self._steady.mean_n)
        return bool((off_n > self._unsteady_n).any())

    def _add(self, stamp_ns: int) -> None:
        assert self._hold is not None
        count = len(self._steady)
        visit = self._hold
        unloaded = Unloaded(self._steady.mean_n, visit.pose_rad, count, stamp_ns, visit.beside_rad)
        try:
            self.calibration = self._calibrator.updated(self.calibration, unloaded)
        except CalibrationError as error:
            self.stop(str(error), stamp_ns)
            return
        self._learn()
        self._is_hold_done = True

    def _learn(self) -> None:
        """State where the calibration comes from, and what it is worth elsewhere."""
        poses = {reading.command_rad.tobytes() for reading in self.calibration.unloaded}
        if poses:
            made_from = f"a commissioning in {len(poses)} poses"
            self.calibration = replace(self.calibration, made_from=made_from)
        elsewhere = self._calibrator.moved(self.calibration)
        self._known_force = self._contacts.known_force(
            self._law, elsewhere.mean, elsewhere.covariance
        )
