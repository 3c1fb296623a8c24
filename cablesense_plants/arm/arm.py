"""An arm with whatever is wrong with its body, actuators and sensors, and its readings."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.body import Body, Creep, Nominal, PlantFriction, rigid_body
from cablesense_plants.arm.path import QuasiStaticPath
from cablesense_plants.arm.protocol import Schedule
from cablesense_plants.arm.statics import borne_shares, cable_lengths_m, follow_path
from cablesense_plants.cases import NO_FAULT, PlantError

DriftShape = Literal["linear", "slow sine", "random walk", "warm-up"]
Filter = Literal["first order", "moving average", "second order, critically damped"]

_MARGIN, _HALVINGS = 1.5, 6
"""By how much an arm as drawn bears more than a load of a recording, so that a changed arm bears
it too; how often the angles of poses are halved until it rests in all of them."""
_FINE = 10
"""Samples of a filter between two readings."""
_MASS_SHARE, _PRETENSION_N, _CONTACT_M, _HOLE_DEG, _ZERO_N = 0.005, 0.15, 0.0003, 0.05, 0.05
"""Standard deviations of manufacturing."""


@dataclass(frozen=True)
class ActuatorFaults:
    """Faults of M actuators; by default they follow the command exactly.

    Attributes:
        play_m: (M,) lost motion on reversal, from end to end.
        play_start: (M,) where in the play each begins, -1 to 1.
        ratio: (M,) metres paid out for one that is commanded.
        screw_m: (M,) amplitude of an error periodic in the length, of period `screw_pitch_m`.
        screw_phase_rad: (M,) its phase at the straight arm.
        slip_m: (M,) length that each clamp lets through at `slip_time_s`.
    """

    play_m: Array = NO_FAULT
    play_start: Array = NO_FAULT
    ratio: Array = NO_FAULT + 1.0
    screw_m: Array = NO_FAULT
    screw_phase_rad: Array = NO_FAULT
    slip_m: Array = NO_FAULT
    screw_pitch_m: float = 0.004
    slip_time_s: float = np.inf

    def paid_out_m(self, commanded_m: Array, time_s: Array) -> Array:
        """(R, M) lengths given, of those commanded, both less that of the straight arm."""
        phase = 2.0 * np.pi * commanded_m / self.screw_pitch_m + self.screw_phase_rad
        uneven = self.screw_m * (np.sin(phase) - np.sin(self.screw_phase_rad))
        slipped = (time_s >= self.slip_time_s)[:, None] * self.slip_m
        given = self.ratio * commanded_m
        if self.play_m.any():
            half = 0.5 * self.play_m
            at = given[0] + half * self.play_start
            for row in given:
                row[:] = at = np.clip(at, row - half, row + half)
        return given + uneven + slipped


@dataclass(frozen=True)
class Dropouts:
    """Channels that repeat their last value for a while.

    Attributes:
        share: (M,) of the rows in which a channel does.
        mean_rows: how long a dropout lasts on average.
        seed: of when they come.
    """

    share: Array = NO_FAULT
    mean_rows: float = 20.0
    seed: int = 0

    def repeated_n(self, signal_n: Array) -> Array:
        """(R, M) signals, through each dropout the last value before it."""
        if not self.share.any():
            return signal_n
        rng = np.random.default_rng(self.seed)
        rows = len(signal_n)
        last = np.tile(np.arange(rows)[:, None], (1, len(self.share)))
        for channel in np.flatnonzero(self.share):
            gap = self.mean_rows * (1.0 / self.share[channel] - 1.0)
            at = 1.0 + rng.exponential(gap)
            while at < rows:
                end = at + 1.0 + rng.exponential(self.mean_rows)
                last[int(at) : int(end), channel] = int(at) - 1
                at = end + 1.0 + rng.exponential(gap)
        return np.take_along_axis(signal_n, last, axis=0)


@dataclass(frozen=True)
class Drift:
    """Drift of zeros, of one shape and different sizes.

    Attributes:
        size_n: (M,) how far each goes within a recording, either way.
        time_s: period of a sine, time constant of a warm-up.
        phase_rad: of the sine.
        seed: of the walk.
    """

    size_n: Array = NO_FAULT
    shape: DriftShape = "linear"
    time_s: float = 100.0
    phase_rad: float = 0.0
    seed: int = 0

    def zeros_n(self, time_s: Array) -> Array:
        """Zeros (R, M) at times (R,); (R, 1) where none drifts."""
        since = (time_s - time_s[0])[:, None]
        if not self.size_n.any():
            return np.zeros_like(since)
        if self.shape == "linear":
            shape = since / since[-1]
        elif self.shape == "slow sine":
            shape = np.sin(2.0 * np.pi * since / self.time_s + self.phase_rad)
        elif self.shape == "warm-up":
            shape = 1.0 - np.exp(-since / self.time_s)
        else:
            rng = np.random.default_rng(self.seed)
            walk = np.cumsum(rng.standard_normal((len(time_s), len(self.size_n))), axis=0)
            shape = (walk - walk[0]) / np.abs(walk - walk[0]).max(axis=0)
        return shape * self.size_n


@dataclass(frozen=True)
class SensorFaults:
    """Faults of M sensors, in the order in which a signal meets them; by default none.

    Attributes:
        bow_from_n: tension at which the nonlinearity is zero.
        gain: (M,) reading by tension.
        bow_per_n: (M,) nonlinearity: change of the gain with each newton above `bow_from_n`.
        ceiling_n: (M,) where a soft saturation sets in.
        leak: (M, M) share of the column's signal in the row's.
        lag_s: (M,) time constant, or half the window of an average.
        offset_n: (M,) zero errors.
        hum_n: (M,) amplitude of an interference of `hum_hz`.
        hum_phase_rad: (M,) its phase.
    """

    bow_from_n: float
    gain: Array = NO_FAULT + 1.0
    bow_per_n: Array = NO_FAULT
    ceiling_n: Array = NO_FAULT + np.inf
    leak: Array = NO_FAULT
    lag_s: Array = NO_FAULT
    lag_filter: Filter = "first order"
    offset_n: Array = NO_FAULT
    drift: Drift = Drift()
    hum_n: Array = NO_FAULT
    hum_hz: float = 0.3
    hum_phase_rad: Array = NO_FAULT
    dropouts: Dropouts = Dropouts()

    def signals_n(self, tension_n: Array, time_s: Array) -> Array:
        """(R, M) noise-free readings of tensions (R, M) at times (R,)."""
        signal = tension_n * (self.gain + self.bow_per_n * (tension_n - self.bow_from_n))
        over = np.maximum(signal - self.ceiling_n, 0.0)
        signal = np.where(over > 0.0, self.ceiling_n + over / (1.0 + over / 10.0), signal)
        if self.leak.any():
            signal = signal + signal @ self.leak.T
        signal = self._lagged(signal, time_s)
        hum = np.sin(2.0 * np.pi * self.hum_hz * time_s[:, None] + self.hum_phase_rad)
        signal = signal + self.offset_n + self.drift.zeros_n(time_s) + self.hum_n * hum
        return self.dropouts.repeated_n(signal)

    def _lagged(self, signal_n: Array, time_s: Array) -> Array:
        """Each column through its filter, settled at the first value before."""
        from scipy.signal import lfilter

        steps = len(time_s) - 1
        fine_s = np.interp(np.arange(steps * _FINE + 1) / _FINE, np.arange(steps + 1), time_s)
        period_s = float(fine_s[1] - fine_s[0])
        late = signal_n.copy()
        for column in np.flatnonzero(self.lag_s):
            fine = np.interp(fine_s, time_s, signal_n[:, column])
            if self.lag_filter == "moving average":
                fine = _averaged(fine, max(1.0, 2.0 * self.lag_s[column] / period_s))
            else:
                order = 1 if self.lag_filter == "first order" else 2
                kept = np.exp(-period_s / (self.lag_s[column] / order))
                for _stage in range(order):
                    fine, _ = lfilter([1.0 - kept], [1.0, -kept], fine, zi=[kept * fine[0]])
            late[:, column] = fine[::_FINE]
        return late


def _averaged(signal: Array, window: float) -> Array:
    """Mean over the last `window` samples, which need not be a whole number."""
    whole = int(np.ceil(window))
    total = np.concatenate([[0.0], np.cumsum(np.pad(signal, (whole, 0), mode="edge"))])
    ends = whole + np.arange(1, len(signal) + 1)
    starts = np.interp(ends - window, np.arange(len(total)), total)
    return (total[ends] - starts) / window


@dataclass(frozen=True)
class RealArm:
    """An arm with whatever is wrong with it; by default nothing.

    Attributes:
        nominal: the arm as drawn, by which its actuators are commanded.
        load_turn: (3, 3) from the load that is written down to the one that acts.
    """

    nominal: Nominal
    body: Body
    sensing: SensorFaults
    load_turn: Array
    actuation: ActuatorFaults = ActuatorFaults()
    friction: PlantFriction = field(default_factory=PlantFriction)
    creep: Creep = field(default_factory=Creep)

    @property
    def history_dependent(self) -> bool:
        """Whether a rest depends on those before."""
        friction = self.friction.coefficient.any() or self.friction.joint_nm.any()
        return bool(friction or self.creep.compliance_m_n.any())

    def signals_n(self, schedule: Schedule, history: Schedule) -> Array:
        """(R, M) noise-free readings over a schedule, after a history that is not recorded.

        Raises:
            PlantError: the arm finds no rest in some row.
        """
        before = len(history.time_s)
        command = np.concatenate([history.command_rad, schedule.command_rad])
        time_s = np.concatenate([history.time_s, schedule.time_s])
        drawn = [self.point_loads_n(each) for each in (history, schedule)]
        loads = np.concatenate(drawn) @ self.load_turn.T
        paid_out = self.actuation.paid_out_m(self.held_m(command), time_s)
        if self.history_dependent:
            tension = self._path_tensions_n(command, paid_out, loads, time_s)
        else:
            tension = follow_path(self.body, command, paid_out, loads).tensions_n
        return self.sensing.signals_n(np.maximum(tension[before:], 0.0), schedule.time_s)

    def point_loads_n(self, schedule: Schedule) -> Array:
        """(R, 4N, 3) the loads at the points of `Body.contact_at_m`, as they are written down.

        A load between two points acts on both by the law of the lever: force and moment are the
        same, and each half of a segment has points at both of its ends.
        """
        middle_m = 0.5 * self.nominal.length_m
        share = np.nan_to_num(schedule.load_at_m)[:, None] / middle_m
        lever = [np.clip(1.0 - np.abs(share - k), 0.0, 1.0) for k in range(3)]
        stated = np.isfinite(schedule.load_at_m)[:, None]
        shares = [~stated, *(stated * each for each in lever)]
        return np.concatenate([each[..., None] * schedule.forces_n for each in shares], axis=1)

    def within_strength(self, schedule: Schedule) -> Schedule:
        """The schedule with smaller angles and loads where the arm does not bear those given.

        All angles are halved together until each pose leaves a rest. The load of a trial is
        reduced as a whole, by what the arm bears at its peak.

        Raises:
            PlantError: the unloaded arm finds no rest even near straight.
        """
        starts = np.flatnonzero(np.diff(schedule.trial, prepend=schedule.trial[0] - 1))
        size_n = np.linalg.norm(schedule.load_n, axis=1)
        ends = np.append(starts[1:], len(size_n))
        peaks = np.array([a + np.argmax(size_n[a:b]) for a, b in zip(starts, ends, strict=True)])
        corners = np.concatenate([schedule.command_rad.argmin(0), schedule.command_rad.argmax(0)])
        rows = np.concatenate([peaks, corners])
        for _ in range(_HALVINGS):
            command = schedule.command_rad[rows]
            loads_n = self.point_loads_n(schedule)[rows]
            loads_n[len(peaks) :] = 0.0
            borne = borne_shares(self.body, command, self.held_m(command), _MARGIN * loads_n)
            if (borne >= 0.0).all():
                break
            schedule = schedule._replace(command_rad=np.round(0.5 * schedule.command_rad, 6))
        else:
            raise PlantError(
                "the arm finds no rest even near straight; raise cables.pretension_n or the "
                "cables' stiffness"
            )
        share = np.repeat(np.minimum(_MARGIN * borne[: len(peaks)], 1.0), ends - starts)
        return schedule.loaded_by(np.round(share[:, None] * schedule.load_n, 3) + 0.0)

    def held_m(self, command_rad: Array) -> Array:
        """(R, M) cable paid out by commands (R, 2N) as drawn, minus that of the straight arm."""
        drawn = rigid_body(self.nominal)
        straight = cable_lengths_m(drawn, np.zeros((1, command_rad.shape[1])))
        return cable_lengths_m(drawn, command_rad) - straight

    def path(self) -> QuasiStaticPath:
        """Takes arms like this one, with friction and creep, from rest to rest."""
        return QuasiStaticPath(self.body, self.friction, self.creep, self.nominal.run_m)

    def _path_tensions_n(
        self, command: Array, paid_out: Array, loads: Array, time_s: Array
    ) -> Array:
        path = self.path()
        state = path.start(command[:1], paid_out[:1], loads[:1])
        tension = np.empty_like(paid_out)
        tension[0] = state.sensed_n[0]
        timeless = not self.creep.compliance_m_n.any() and self.friction.joint_breakaway == 1.0
        for row in range(1, len(tension)):
            still = np.array_equal(paid_out[row], paid_out[row - 1])
            if not (timeless and still and np.array_equal(loads[row], loads[row - 1])):
                period_s = float(time_s[row] - time_s[row - 1])
                state = path.advance(state, paid_out[row, None], loads[row, None], period_s)
            tension[row] = state.sensed_n[0]
        return tension


def ideal_arm(nominal: Nominal) -> RealArm:
    """The arm exactly as drawn."""
    return RealArm(nominal, rigid_body(nominal), SensorFaults(nominal.pretension_n), np.eye(3))


def with_tolerances(arm: RealArm, rng: np.random.Generator) -> RealArm:
    """The arm with manufacturing tolerances: normal, of the standard deviations of this module.

    The holes of one cable share their error, as those of a drilling template do.
    """
    body, cables = arm.body, arm.body.cable_count
    masses = body.mass_kg * (1.0 + _MASS_SHARE * rng.standard_normal(len(body.mass_kg)))
    contact = body.contact_at_m.copy()
    contact[..., 0] += _CONTACT_M * rng.standard_normal(contact.shape[1])
    pretension = body.pretension_n + _PRETENSION_N * rng.standard_normal(cables)
    by_rad = np.deg2rad(_HOLE_DEG) * rng.standard_normal(cables)
    zeros = arm.sensing.offset_n + _ZERO_N * rng.standard_normal(cables)
    before, after = turned(body.before_m, by_rad), turned(body.after_m, by_rad)
    body = replace(
        body, mass_kg=masses, pretension_n=pretension, contact_at_m=contact,
        before_m=before, after_m=after,
    )  # fmt: skip
    return replace(arm, body=body, sensing=replace(arm.sensing, offset_n=zeros))


def turned(points_m: Array, by_rad: Array) -> Array:
    """Points (..., 3) turned about x, from +z towards +y."""
    sine, cosine = np.sin(by_rad), np.cos(by_rad)
    x, y, z = np.moveaxis(points_m, -1, 0)
    return np.stack([x, cosine * y + sine * z, cosine * z - sine * y], axis=-1)
