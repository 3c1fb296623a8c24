"""What a recording is made of: trials of rests, loads, poses and holds, and the arm's readings.

An arm has whatever is wrong with its body, actuators and sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import cycle, pairwise
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.body import Body, Ints, Nominal
from cablesense_plants.arm.friction import Creep, PlantFriction, QuasiStaticPath
from cablesense_plants.arm.statics import borne_shares, cable_lengths_m, follow_path
from cablesense_plants.cases import PlantError

SCALED, LIMITED, LEAKED, LATE, ADDED, REPEATED = range(6)
"""The order in which faults of sensors meet a signal."""
PAID, TAKEN_UP, UNEVEN = range(3)
"""The order of those of actuators."""

_MARGIN = 1.5
_HALVINGS = 6
"""By how much an arm as drawn bears more than a load of a recording, so that a changed arm bears
it too; how often the angles of poses are halved until it rests in all of them."""
_MASS_SHARE = 0.005
_PRETENSION_N = 0.15
_CONTACT_M = 0.0003
_HOLE_DEG = 0.05
_ZERO_N = 0.05
"""Standard deviations of manufacturing."""
_ROWS_HZ = 5.0
"""Rate at which trials are laid out, below."""
_UP = np.linspace(0.0, 1.0, 12)[1:-1]
_CYCLE = np.concatenate([_UP, np.ones(9), _UP[::-1], np.zeros(4)])
_HOLD = np.concatenate([np.linspace(0.0, 1.0, 6)[1:], np.ones(120), np.zeros(80)])
_REST_ROWS = 20
_SWEEP_ROWS = 440
_MOVE_ROWS = 20
_STAY_ROWS = 5
_STRAIGHT_N = (30.0, 75.0)
_POSED_N = (20.0, 60.0)
"""Peak loads on the laboratory arm; another one bears more or less, see `_schedule`."""
_SWEEP_DEG = (6.0, 9.5)
_POSE_DEG = (3.0, 9.0)
_HISTORY_KNOTS = 6
_HISTORY_ROWS = 8
_HISTORY_DEG = 6.0

Faults = tuple[tuple[int, Callable[..., Array]], ...]


class Schedule(NamedTuple):
    """Rows of a recording before anything is read.

    Attributes:
        time_s: (R,) since the recording began; negative in what went before.
        trial: (R,) blocks that belong together.
        command_rad: (R, 2N) joint angles.
        load_segment: (R,) 1 to N, 0 without a load.
        load_n: (R, 3) base frame.
        load_at_m: (R,) from the segment's joint centre, on its axis; NaN for its contact point.
    """

    time_s: Array
    trial: Ints
    command_rad: Array
    load_segment: Ints
    load_n: Array
    load_at_m: Array

    def loaded_by(self, load_n: Array) -> Schedule:
        """The same with other loads (R, 3), without segment and place where there is none."""
        loaded = (load_n != 0.0).any(axis=1)
        return self._replace(
            load_segment=np.where(loaded, self.load_segment, 0),
            load_n=load_n,
            load_at_m=np.where(loaded, self.load_at_m, np.nan),
        )

    @property
    def forces_n(self) -> Array:
        """(R, N, 3) the load as one force per segment."""
        segments = np.arange(1, self.command_rad.shape[1] // 2 + 1)
        return (self.load_segment[:, None] == segments)[..., None] * self.load_n[:, None]

    def rows(self, chosen: slice) -> Schedule:
        """The chosen rows."""
        return Schedule._make(column[chosen] for column in self)


@dataclass(frozen=True)
class RealArm:
    """An arm with whatever is wrong with it; by default nothing.

    Attributes:
        nominal: the arm as drawn, by which its actuators are commanded.
        load_turn: (3, 3) from the load that is written down to the one that acts.
        joint_zero_rad: (2N,) by which angles whose lengths are held exceed the commanded ones.
        actuation: gives lengths (R, M), less those of the straight arm, of what earlier faults
            made of the commands, of the commands, and of times (R,).
        sensing: gives signals (R, M) of what earlier faults made of the tensions, and of times.
    """

    nominal: Nominal
    body: Body
    load_turn: Array
    actuation: Faults = ()
    sensing: Faults = ()
    friction: PlantFriction = field(default_factory=PlantFriction)
    creep: Creep = field(default_factory=Creep)
    joint_zero_rad: Array | float = 0.0

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
        if self.friction.weightless:
            history = history.rows(slice(0))
        before = len(history.time_s)
        command = np.concatenate([history.command_rad, schedule.command_rad])
        time_s = np.concatenate([history.time_s, schedule.time_s])
        drawn = [self.point_loads_n(each) for each in (history, schedule)]
        loads = np.concatenate(drawn) @ self.load_turn.T
        paid_out = self.held_m(command)
        held = paid_out
        for fault in _in_order(self.actuation):
            paid_out = fault(paid_out, held, time_s)
        if self.history_dependent:
            tension = self._path_tensions_n(command, paid_out, loads, time_s)
        else:
            tension = follow_path(self.body, command, paid_out, loads)
        signal: Array = np.maximum(tension[before:], 0.0)
        for fault in _in_order(self.sensing):
            signal = fault(signal, schedule.time_s)
        return signal

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
        straight = cable_lengths_m(self.nominal.body, np.zeros((1, command_rad.shape[1])))
        return cable_lengths_m(self.nominal.body, command_rad + self.joint_zero_rad) - straight

    def path(self) -> QuasiStaticPath:
        """Takes this arm, with friction and creep, from rest to rest."""
        return QuasiStaticPath(self.body, self.friction, self.creep, self.nominal.run_m)

    def _path_tensions_n(
        self, command: Array, paid_out: Array, loads: Array, time_s: Array
    ) -> Array:
        path = self.path()
        state = path.start(command[0], paid_out[0], loads[0])
        tension = np.empty_like(paid_out)
        tension[0] = state.sensed_n
        timeless = not self.creep.compliance_m_n.any() and self.friction.joint_breakaway == 1.0
        for row in range(1, len(tension)):
            still = np.array_equal(paid_out[row], paid_out[row - 1])
            if not (timeless and still and np.array_equal(loads[row], loads[row - 1])):
                period_s = float(time_s[row] - time_s[row - 1])
                state = path.advance(state, paid_out[row], loads[row], period_s)
            tension[row] = state.sensed_n
        return tension


def _in_order(faults: Faults) -> list[Callable[..., Array]]:
    return [fault for _, fault in sorted(faults, key=lambda each: each[0])]


def ideal_arm(nominal: Nominal) -> RealArm:
    """The arm exactly as drawn."""
    return RealArm(nominal, nominal.body, np.eye(3))


def with_tolerances(arm: RealArm, rng: np.random.Generator) -> RealArm:
    """The arm with manufacturing tolerances: normal, of the standard deviations of this module.

    The holes of one cable share their error, as those of a drilling template do.
    """
    body = arm.body
    cables = arm.body.cable_count
    masses = body.mass_kg * (1.0 + _MASS_SHARE * rng.standard_normal(len(body.mass_kg)))
    contact = body.contact_at_m.copy()
    contact[..., 0] += _CONTACT_M * rng.standard_normal(contact.shape[1])
    pretension = body.pretension_n + _PRETENSION_N * rng.standard_normal(cables)
    by_rad = np.deg2rad(_HOLE_DEG) * rng.standard_normal(cables)
    zeros = _ZERO_N * rng.standard_normal(cables)
    before = turned(body.before_m, by_rad)
    after = turned(body.after_m, by_rad)
    body = replace(
        body,
        mass_kg=masses,
        pretension_n=pretension,
        contact_at_m=contact,
        before_m=before,
        after_m=after,
    )
    wrong_zeros = (ADDED, lambda signal_n, _time_s: signal_n + zeros)
    return replace(arm, body=body, sensing=(*arm.sensing, wrong_zeros))


def turned(points_m: Array, by_rad: Array) -> Array:
    """Points (..., 3) turned about x, from +z towards +y."""
    sine = np.sin(by_rad)
    cosine = np.cos(by_rad)
    x, y, z = np.moveaxis(points_m, -1, 0)
    return np.stack([x, cosine * y + sine * z, cosine * z - sine * y], axis=-1)


def draw_schedule(nominal: Nominal, rng: np.random.Generator) -> Schedule:
    """The trials, 25 for four segments, with loads, orders and poses of this recording's own.

    The loads on a segment act in turn near its joint, at its contact point and far out, in an
    order of their own.
    """
    count = nominal.segment_count
    angles = 2 * count
    segments = range(1, count + 1)
    straight = np.zeros(angles)
    trials = [_still(straight, 0, np.zeros(3), np.zeros(_REST_ROWS))]
    sides = np.array([[0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    for segment in segments:
        for side in rng.permutation(len(sides))[: max(1, 12 // count)]:
            peak = rng.uniform(*_STRAIGHT_N) * sides[side]
            trials.append(_still(straight, segment, peak, _CYCLE))
    trials.append(_moving(_sweep(angles, rng)))
    pose = np.deg2rad(rng.uniform(*_POSE_DEG)) * rng.uniform(-1.0, 1.0, angles)
    ease = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, _MOVE_ROWS + 1) / _MOVE_ROWS)
    trials.append(_moving(np.outer(np.concatenate([ease, np.ones(_STAY_ROWS)]), pose)))
    trials += [_still(pose, segment, _oblique_n(rng), _CYCLE) for segment in segments]
    held_segment = int(rng.integers(min(2, count), count + 1))
    trials.append(_still(pose, held_segment, _oblique_n(rng), _HOLD))
    trials.append(_moving(np.outer(ease[::-1] - ease[0], pose)))
    order = rng.permutation(segments)
    trials += [_still(straight, int(segment), _oblique_n(rng), _CYCLE) for segment in order]
    return _schedule(nominal, trials, _places_m(nominal, [trial[1] for trial in trials], rng))


def _places_m(nominal: Nominal, segments: Sequence[int], rng: np.random.Generator) -> Array:
    """(T,) where the loads of trials on these segments act; NaN without a load."""
    near, far = nominal.touched_m.T
    inside = (far - near) / 6.0
    at_m = np.stack([near + inside, nominal.contact_m, far - inside], axis=1)
    orders = rng.spawn(1)[0].permuted(np.tile(np.arange(3), (len(at_m), 1)), axis=1)
    turns = [cycle(order) for order in orders]
    return np.array([at_m[n - 1, next(turns[n - 1])] if n else np.nan for n in segments])


def draw_history(nominal: Nominal, rng: np.random.Generator) -> Schedule:
    """Moves and pushes that an arm went through before its first row, and that are not recorded.

    It ends straight and unloaded, where every recording begins.
    """
    angles = 2 * nominal.segment_count
    size = np.linspace(1.0, 0.0, _HISTORY_KNOTS)[:, None]
    knots = np.deg2rad(_HISTORY_DEG) * size * rng.uniform(-1.0, 1.0, (1, angles))
    knots = knots * rng.uniform(-1.0, 1.0, (_HISTORY_KNOTS, angles))
    trials = []
    for start, end in pairwise(knots):
        share = np.linspace(0.0, 1.0, _HISTORY_ROWS)[:, None]
        segment = int(rng.integers(1, nominal.segment_count + 1))
        bump = np.sin(np.pi * share) * _oblique_n(rng) * rng.uniform(0.0, 1.0)
        trials.append((start + share * (end - start), segment, bump))
    trials.append(_moving(np.zeros((2, angles))))
    past = _schedule(nominal, trials)
    return past._replace(time_s=past.time_s - len(past.time_s) * (1.0 / nominal.rate_hz))


_Trial = tuple[Array, int, Array]
"""Commands (R, 2N), the loaded segment, and its load (R, 3) were this the laboratory arm."""


def _still(pose: Array, segment: int, peak_n: Array, shape: Array) -> _Trial:
    return np.tile(pose, (len(shape), 1)), segment, shape[:, None] * peak_n


def _moving(commands: Array) -> _Trial:
    return commands, 0, np.zeros((len(commands), 3))


def _schedule(nominal: Nominal, trials: list[_Trial], places_m: Array | None = None) -> Schedule:
    """Loads are scaled by what the cables can hold at the arm's reach; `places_m` (T,) of each."""
    moment_nm = nominal.pretension_n * nominal.radius_m.mean() * nominal.cable_count
    strength = moment_nm / nominal.length_m.sum() / (50.0 * 0.05 * 12 / (4 * 0.13))
    commands, segments, loads = zip(*trials, strict=True)
    rows = [len(command) for command in commands]
    load = np.round(strength * np.concatenate(loads), 3) + 0.0  # no -0.0
    places_m = np.full(len(rows), np.nan) if places_m is None else np.round(places_m, 3)
    done = Schedule(
        time_s=1.0 / _ROWS_HZ * np.arange(sum(rows), dtype=float),
        trial=np.repeat(np.arange(len(rows)), rows),
        command_rad=np.round(np.concatenate(commands), 6) + 0.0,
        load_segment=np.repeat(segments, rows),
        load_n=load,
        load_at_m=np.repeat(places_m, rows),
    ).loaded_by(load)
    return done if nominal.rate_hz == _ROWS_HZ else _sampled(done, nominal.rate_hz)


def _sampled(done: Schedule, rate_hz: float) -> Schedule:
    """The same at another rate: straight on from row to row, in as long a time.

    Between trials no load acts, so that one which rises or falls belongs to the row that has it.
    """
    time_s = np.arange(round(done.time_s[-1] * rate_hz) + 1) / rate_hz
    before = np.clip(np.searchsorted(done.time_s, time_s, "right") - 1, 0, len(done.time_s) - 1)
    after = np.minimum(before + 1, len(done.time_s) - 1)
    share = np.clip((time_s - done.time_s[before]) * _ROWS_HZ, 0.0, 1.0)[:, None]
    share[share < 1e-6] = 0.0  # rounding of times is no load

    def between(column: Array, places: int) -> Array:
        straight = column[before] + share * (column[after] - column[before])
        return np.asarray(np.round(straight, places) + 0.0)

    load = between(done.load_n, 3)
    return Schedule(
        time_s=time_s,
        trial=done.trial[np.where(share[:, 0] > 0.0, after, before)],
        command_rad=between(done.command_rad, 6),
        load_segment=np.maximum(done.load_segment[before], done.load_segment[after]),
        load_n=load,
        load_at_m=np.fmax(done.load_at_m[before], done.load_at_m[after]),
    ).loaded_by(load)


def _sweep(angles: int, rng: np.random.Generator) -> Array:
    """Each joint angle out, back through zero and to the other side, one after the other."""
    rows = np.array_split(np.arange(_SWEEP_ROWS), angles)
    commands = np.zeros((_SWEEP_ROWS, angles))
    for angle, angle_rows in enumerate(rows):
        height = np.deg2rad(rng.uniform(*_SWEEP_DEG)) * rng.choice([-1.0, 1.0])
        commands[angle_rows, angle] = height * np.sin(
            2.0 * np.pi * np.arange(1, len(angle_rows) + 1) / len(angle_rows)
        )
    return commands


def _oblique_n(rng: np.random.Generator) -> Array:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return rng.uniform(*_POSED_N) * np.array([0.0, np.sin(angle), np.cos(angle)])
