"""Tares: the mean of the latest readings of the untouched arm at one pose, and what came before.

On an arm with a law a tare updates the calibration (`calibrated_arm`): the arm is then known
better in every pose. A network gets tension differences, so there it is carried to other poses by
the arm file (`tared_arm`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_contact.calibration import Calibration, Unloaded
from cablesense_contact.felt import ChannelLimits, FeltMachine
from cablesense_online.settings import EstimationSettings

MOST_UNDOABLE = 16
"""How many times a tare can be undone."""
_ONE_POSE_RAD = 1e-3
"""Readings of a tare are of poses within this of the first."""


class TareError(CableSenseError):
    """No tare can be taken or undone now; the message states why, and what to do."""


def utc_text(time_ns: int) -> str:
    """A time since the epoch to the second, as diagnostics show it."""
    return f"{datetime.fromtimestamp(time_ns // 1_000_000_000, UTC):%Y-%m-%d %H:%M:%S UTC}"


@dataclass(frozen=True)
class Tare:
    """The mean of some readings of the untouched arm, as the estimator took it.

    Attributes:
        unloaded: the readings.
        by_itself: whether it was taken by `auto_tare`.
        misfit: by how much the observations differed from what was expected: (M,) of the
            readings, N; of a machine whose joints are measured the joints' torques, N·m.
    """

    unloaded: Unloaded
    by_itself: bool
    misfit: Array

    def described(self, machine: FeltMachine) -> str:
        """Time and values, as text for a log."""
        names = machine.channels.names
        readings = [
            f"{name} {reading:.2f}"
            for name, reading in zip(names, self.unloaded.reading_n, strict=True)
        ]
        taken = f"at {utc_text(self.unloaded.taken_ns)}: average of {self.unloaded.count} readings"
        if machine.reads_joints:
            off_n_m = np.abs(self.misfit).max()
            expected = f"joints' torques within {off_n_m:.2g} N·m of what was expected"
            return f"{taken}: {', '.join(readings)}; {expected}"
        deviations = ", ".join(
            f"{reading} ({off:+.2f})" for reading, off in zip(readings, self.misfit, strict=True)
        )
        return f"{taken}; in N, with the deviation from what was expected: {deviations}"


Known = TypeVar("Known")


@dataclass(frozen=True)
class UnloadedState(Generic[Known]):
    """What is known of the unloaded arm, the tares so far, and the readings of the next one.

    Attributes:
        known_by: what tares have led to: a calibration, or the tare itself.
        loaded: whether it was known without any tare.
        automatic: whether a tare is to be taken as soon as nothing is against it.
        pose_rad: (2N,) present pose, of a machine (C,), rad or m; None before the first sample.
        readings: each (M,), of the next tare, in the channels' units.
        tares: those in force, the latest last.
        earlier: what was known before each tare, and before each calibration that was loaded.
    """

    known_by: Known
    loaded: bool
    automatic: bool
    pose_rad: Array | None = None
    readings: tuple[Sequence[float], ...] = ()
    tares: tuple[Tare, ...] = ()
    earlier: tuple[Known, ...] = ()

    @property
    def known(self) -> bool:
        """Whether there is an unloaded state: a tare, or a calibration that was loaded."""
        return self.loaded or bool(self.tares)

    @property
    def undoable(self) -> int:
        """How many times a tare, or a calibration that was loaded, can be undone."""
        return len(self.earlier)

    @property
    def without_readings(self) -> Self:
        """The same, with all earlier readings excluded from the next tare."""
        return replace(self, readings=()) if self.readings else self


State = TypeVar("State", bound=UnloadedState)  # type: ignore[type-arg]


class UnloadedArm(Protocol[State]):
    """How the unloaded state of one arm goes on; a state goes in, the next one comes out."""

    def begin(self, calibration: Calibration | None = None) -> State:
        """The state at the start, of an arm as well known as a calibration says.

        Raises:
            TareError: a calibration is given, and the model takes none.
        """
        ...

    def at(self, state: State, pose_rad: Array) -> State:
        """Readings are from now on of this pose (2N,)."""
        ...

    def taken(
        self, state: State, now_ns: int, *, by_itself: bool = False, forced: bool = False
    ) -> State:
        """With the average of the last readings as a tare at the present pose.

        `now_ns` is the time since the epoch. `forced` takes any steady readings.

        Raises:
            TareError: too few readings yet, they are not steady, or they are not those of the
                untouched arm.
        """
        ...

    def undone(self, state: State) -> State:
        """The state before the last tare.

        Raises:
            TareError: there is nothing to undo.
        """
        ...


def with_reading(state: State, reading_n: Sequence[float], most: int) -> State:
    """With a reading (M,) at the present pose, of the arm at rest; the last `most` count.

    It is in the channels' units, N or N·m.
    """
    return replace(state, readings=(*state.readings, reading_n)[-most:])


def is_same_pose(state: UnloadedState[Known], pose_rad: Array) -> bool:
    """Whether the readings so far are of this pose (2N,)."""
    earlier_rad = state.pose_rad
    return earlier_rad is not None and bool(np.abs(pose_rad - earlier_rad).max() <= _ONE_POSE_RAD)


def refusal(
    state: UnloadedState[Known], settings: EstimationSettings, channels: ChannelLimits
) -> str:
    """Why the last readings of the channels are no tare, as text; empty where they may be one."""
    count = settings.tare_samples
    if len(state.readings) < count:
        return (
            f"only {len(state.readings)} of {count} usable readings at this pose yet; wait a "
            "moment with the arm at rest and call again"
        )
    spread = np.std(state.readings, axis=0)
    worst = int(np.argmax(spread))
    if spread[worst] > settings.tare_steady_n:
        unit = channels.units[worst]
        enough = math.ceil(100.0 * spread[worst]) / 100.0
        return (
            f"{channels.names[worst]} varies by {spread[worst]:.2f} {unit} (standard deviation; "
            f"at most {settings.tare_steady_n:g} {unit}); let the arm rest with nothing touching "
            f"it and call again, or, if it does and its sensors are so noisy, set tare_steady_n "
            f"to {enough:.2f} or more"
        )
    return ""


def unloaded_reading(
    state: UnloadedState[Known],
    settings: EstimationSettings,
    channels: ChannelLimits,
    now_ns: int,
    came_from_rad: Array | None = None,
) -> Unloaded:
    """The mean of the last readings of the channels, as a tare at `now_ns` since the epoch.

    `came_from_rad` (2N,) is where the arm came from, if known.

    Raises:
        TareError: too few readings yet, or they are not steady.
    """
    if problem := refusal(state, settings, channels):
        raise TareError(problem)
    assert state.pose_rad is not None
    mean_n = np.mean(state.readings, axis=0)
    return Unloaded(mean_n, state.pose_rad, len(state.readings), now_ns, came_from_rad)


def tare_undone_line(
    undone: Tare,
    in_force: Tare | None,
    machine: FeltMachine,
    undoable: int,
    *,
    replaced: bool = False,
) -> str:
    """Log line of an undo: the undone tare, the one in force, and how many `undoable` remain.

    `replaced` says that the one in force was taken in place of the undone one.
    """
    line = f"tare of {utc_text(undone.unloaded.taken_ns)} undone; "
    if in_force is None:
        return line + "there is none now"
    described = in_force.described(machine)
    if replaced:
        return f"{line}it was the only one, so another took its place {described}"
    return f"{line}again in force is the one {described}; {undoable} left to undo"
