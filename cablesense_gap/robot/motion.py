"""Motion as it is compared: smoothed, a trajectory of joints, and torques along it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from cablesense_base import Array
from cablesense_gap.diagnosis.discrepancy import Conditions
from cablesense_gap.robot.model import Change
from cablesense_recording.robot_recording import TrialLabel

LEAST_FLOOR = 0.005
"""Of a joint's torque: no model of a machine is better."""
_MOST_RECENT = 48
"""Results that are kept: more than one step of a fit asks for, few enough for the memory."""


def smoothed(signal: Array, rate_hz: float, bandwidth_hz: float) -> Array:
    """(T, …) of evenly sampled signals (T, …), smoothed with a stated bandwidth.

    A Butterworth filter of third order, forwards and backwards: no lag, and a gain of
    1 / (1 + (f / bandwidth)^6), that of a smoothing spline with a penalty on the third derivative.
    Whatever is compared with smoothed motion goes through the same filter.
    """
    if len(signal) < 8:
        return np.repeat(signal.mean(0, keepdims=True), len(signal), axis=0)
    most = len(signal) - 1
    pad = min(int(3.0 * rate_hz / bandwidth_hz), most)
    return np.asarray(sosfiltfilt(_sections(rate_hz, bandwidth_hz), signal, axis=0, padlen=pad))


@lru_cache
def _sections(rate_hz: float, bandwidth_hz: float) -> Array:
    return np.asarray(butter(3, bandwidth_hz, fs=rate_hz, output="sos"))


def derivatives(signal: Array, rate_hz: float) -> tuple[Array, Array]:
    """First and second time derivatives (T, J) of smoothed signals (T, J), by five points."""
    padded = np.concatenate([signal[[0, 0]], signal, signal[[-1, -1]]])
    a, b, c, d, e = (padded[k : k + len(signal)] for k in range(5))
    first = (a - 8.0 * b + 8.0 * d - e) * (rate_hz / 12.0)
    second = (-a + 16.0 * b - 30.0 * c + 16.0 * d - e) * (rate_hz**2 / 12.0)
    return first, second


def noise_of_smoothed(density: Array, *bandwidths_hz: float) -> Array:
    """Standard deviation of white noise after filters of some bandwidths."""
    frequency, gain = through(*bandwidths_hz)
    return np.asarray(np.sqrt(density * gain.sum() * frequency[1]))


def through(*bandwidths_hz: float) -> tuple[Array, Array]:
    """Frequencies (F,) and the gains (F,) of power by filters of some bandwidths."""
    frequency = np.linspace(0.0, 6.0 * max(bandwidths_hz), 2000)
    gains = [1.0 / (1.0 + (frequency / each) ** 6) for each in bandwidths_hz]
    return frequency, np.asarray(np.prod(gains, axis=0) ** 2)


class Recent(dict[tuple[Any, ...], Array]):
    """Results of the last calls by their arguments; none is pickled."""

    def of(self, key: tuple[Any, ...], made: Callable[[], Array]) -> Array:
        """The result for a key, made where it is not known."""
        if key not in self:
            if len(self) >= _MOST_RECENT:
                self.pop(next(iter(self)))
            self[key] = made()
        return self[key]

    def __reduce__(self) -> tuple[type[Recent], tuple[()]]:
        """Pickle the type alone: the copy begins without results."""
        return Recent, ()


def rms(values: Array) -> float:
    """Root mean square of all values, in their unit."""
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True)
class Scale:
    """How large torques and motion are in one recording; typical sizes follow from it.

    Attributes:
        torque: (J,) root mean square of the torque at each joint.
        speed: (J,) root mean square of its speed while it moves.
        acceleration: (J,) root mean square of its acceleration while it moves.
        position: (J,) half its span.
        inertia: (J,) that it feels alone, by the nominal model.
    """

    torque: Array
    speed: Array
    acceleration: Array
    position: Array
    inertia: Array

    def per(self, other: Array) -> float:
        """The typical ratio of a joint's torque to another quantity (J,) of that joint."""
        return rms(self.torque / np.maximum(other, 1e-2 * rms(other) + 1e-9))

    @property
    def typical_torque(self) -> float:
        """Root mean square over all joints."""
        return rms(self.torque)


class Stribeck(NamedTuple):
    """By how much more friction is at rest, as a share, and the speed at which 1/e is left."""

    share: float = 0.0
    speed: float = 1.0

    def over(self, speed: Array) -> Array:
        """Friction at speeds, by that of fast motion: 1 + share · exp(-(speed / least)²)."""
        if not self.share:
            return np.ones_like(speed)
        return np.asarray(1.0 + self.share * np.exp(-((speed / self.speed) ** 2)))


_NO_STRIBECK = Stribeck()


@dataclass(frozen=True)
class Trajectory:
    """Motion of R rows.

    Attributes:
        position, speed, acceleration: (R, J).
        direction: (R, J) of each joint's motion, -1 to 1.
        load: (R, J) torques that act on geared joints from outside, zero at the others.
        command: (R, A) of the actuators, NaN where none was recorded.
    """

    time_s: Array
    trial: NDArray[np.int64]
    position: Array
    speed: Array
    acceleration: Array
    direction: Array
    load: Array
    command: Array

    def slid(self, joint: int, presliding: float, stribeck: Stribeck = _NO_STRIBECK) -> Array:
        """(R,) share of its dry friction that acts on a joint: after Dahl, -1 to 1, and LuGre.

        A joint that turns round gives elastically over about `presliding`, in the position's
        unit, until it slips the other way; with none, friction turns round with the motion.
        """
        if presliding <= 0.0:
            return self.direction[:, joint] * stribeck.over(self.speed[:, joint])
        unit_motion = np.zeros_like(self.position)
        unit_motion[:, joint] = 1.0
        return self.slid_along(unit_motion, presliding, stribeck)

    def slid_along(self, by_joint: Array, give: float, stribeck: Stribeck = _NO_STRIBECK) -> Array:
        """(R,) the same along a way that grows by (R, J) of each joint's motion."""
        way_speed = (self.speed * by_joint).sum(1)
        parts = (self._by_trial(each) for each in (self.position, by_joint, way_speed))
        shares = [
            _bent(_way(position, along), give, stribeck.over(speed))
            for position, along, speed in zip(*parts, strict=True)
        ]
        return np.concatenate(shares)

    def _by_trial(self, rows: Array) -> list[Array]:
        return np.split(rows, np.flatnonzero(np.diff(self.trial)) + 1)


@dataclass(frozen=True)
class Trial:
    """One trial at the recording's rate: T rows, each (T, …).

    Attributes:
        number, label: of `RobotRecording.trial` and `trial_label`.
    """

    number: int
    label: TrialLabel
    time_s: Array
    position: Array
    torque: Array
    command: Array


class Noise(NamedTuple):
    """Power densities (J,), by hertz."""

    position: Array
    torque: Array


@dataclass(frozen=True)
class Motion(Trajectory):
    """Smoothed motion at R rows, and how torques at these rows become Q rows that are compared.

    Attributes:
        torque: (R, J) of the drives; NaN for joints without.
        counts: (R, J) where the torque is compared: the joint moves, and its torque was measured.
        floor: (J,) noise of the compared torques, from torques and positions.
        scale: how large torques and motion are.
        trials: at the recording's rate, with smoothed positions; torques are the drives'.
        by_command: whether these are what the model's actuators make of the commands.
        rate_hz: of the recording.
        step: of its rows from one of the R to the next.
        smoothed_hz: bandwidth of the motion.
        compared_hz: bandwidth of the comparison.
        passes: by trial, rows (P, R_t) that take torques of its rows to P compared ones.
        compared_trial, compared_time_s: (Q,) of those; trials without any have no number.
        compared_labels: of the trials in `compared_trial`, as the recording's user knows them.
        forward: whether the comparison is to go forward in time.
        zeroed: whether encoders were set to zero where each trial begins.
        external: whether positions were measured outside the drives.
        noise: of what was measured.
        inertia: (J,) that each joint feels alone.
        gain: (J,) N·m or N that one unit of the recorded torques is taken for.
        unknown_gain: (J,) whether that is an estimate, which is fitted.
    """

    torque: Array
    counts: NDArray[np.bool_]
    floor: Array
    scale: Scale
    trials: tuple[Trial, ...]
    by_command: bool
    rate_hz: float
    step: int
    smoothed_hz: float
    compared_hz: float
    passes: tuple[Array, ...]
    compared_trial: NDArray[np.int64]
    compared_labels: tuple[TrialLabel, ...]
    compared_time_s: Array
    forward: bool
    zeroed: bool
    external: bool
    noise: Noise
    inertia: Array
    gain: Array
    unknown_gain: NDArray[np.bool_]

    @cached_property
    def paths(self) -> list[Array]:
        """By trial, the smoothed positions (T, J) at the recording's rate."""
        return [trial.position for trial in self.trials]

    @cached_property
    def inner(self) -> list[NDArray[np.int64]]:
        """By trial, the numbers of the motion's rows among those at the recording's rate."""
        slices = [inner_rows(len(path), self.rate_hz, self.smoothed_hz) for path in self.paths]
        return [np.arange(each.start, each.stop, self.step) for each in slices]

    @property
    def rows(self) -> NDArray[np.int64]:
        """(R,) of its rows among those of all trials at the recording's rate."""
        first = np.cumsum([0, *map(len, self.paths)])
        return np.concatenate([a + rows for a, rows in zip(first, self.inner, strict=False)])

    def slid_along(self, by_joint: Array, give: float, stribeck: Stribeck = _NO_STRIBECK) -> Array:
        """(R,) share of dry friction along a way that grows by (R, J) of each joint's motion.

        Between rows a joint may turn round, so it goes the whole path.
        """
        shares = []
        for path, rows, trial_joints in zip(
            self.paths, self.inner, self._by_trial(by_joint), strict=True
        ):
            whole = np.stack(
                [np.interp(np.arange(len(path)), rows, b) for b in trial_joints.T], axis=1
            )
            way = _way(path, whole)
            speed = np.diff(way, append=way[-1]) * self.rate_hz
            share = _bent(way, give, stribeck.over(speed))
            shares.append(smoothed(share, self.rate_hz, self.smoothed_hz)[rows])
        return np.concatenate(shares)

    def compared(self, torque: Array) -> Array:
        """(Q, J) of torques (R, J): those that do not count taken out, then the low-pass."""
        return self.passed(np.where(self.counts, torque, 0.0))

    def passed(self, values: Array) -> Array:
        """(Q, J) of values (R, J) behind the low-pass."""
        parts = self._by_trial(values)
        return np.concatenate(
            [low_pass @ part for low_pass, part in zip(self.passes, parts, strict=True)]
        )


def inner_rows(count: int, rate_hz: float, smoothed_hz: float) -> slice:
    """Rows without those at both ends where the filter has one side."""
    edge = min(round(rate_hz / smoothed_hz), count // 3)
    return slice(edge, count - edge)


def _way(position: Array, by_joint: Array) -> Array:
    """(T,) that grows by (T, J) of each joint's motion, positions (T, J)."""
    step = 0.5 * (by_joint[1:] + by_joint[:-1]) * np.diff(position, axis=0)
    return np.concatenate([[0.0], np.cumsum(step.sum(1))])


def _bent(position: Array, presliding: float, slips_at: Array) -> Array:
    """Shares (T,) of dry friction along a path (T,), from none at its beginning.

    Bristles bend by LuGre's law, d share = (1 - share / slips_at) d position / presliding, where
    the joint moves forwards; `slips_at` (T,) is the share at which they slip, 1 by Dahl's law.
    """
    moved = np.diff(position, prepend=position[0])
    stays = np.exp(-np.abs(moved) / (presliding * slips_at))
    ends = np.sign(moved) * slips_at
    share = 0.0
    shares = []
    for end, stay in zip(ends.tolist(), stays.tolist(), strict=True):
        share = end + (share - end) * stay
        shares.append(share)
    return np.array(shares)


class MotionComparison(ABC):
    """Q rows of C channels that were measured, and that variants of a robot predict.

    Attributes:
        names, columns, units: of the channels, as verdicts and as tables call them.
        floor: (C,) residual of a perfect model.
        noise: (C,) the same, over all rows, of which some may not count for a channel.
        readings: (Q, C) in those units.
        trial, time_s: (Q,).
        trial_labels: of the trials in `trial`, 0 to T - 1, as the recording's user knows them.
        description: how it is compared, as a sentence.
    """

    names: tuple[str, ...]
    columns: tuple[str, ...]
    units: tuple[str, ...]
    floor: Array
    noise: Array
    readings: Array
    trial: NDArray[np.int64]
    trial_labels: tuple[TrialLabel, ...]
    time_s: Array
    description: str

    @abstractmethod
    def predicted(self, change: Change) -> Array:
        """Channels (Q, C) by a variant of the robot, in their own units."""

    @abstractmethod
    def conditions(self, change: Change) -> Conditions:
        """Of each channel's joint, (R, C), with the load of a variant of the robot."""

    def compared(self, column: Array) -> Array:
        """(Q, C) of functions of these conditions (R, C)."""
        return column
