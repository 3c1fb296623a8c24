"""The protocol of a recording: trials of rests, loads, poses and holds."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle, pairwise
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.body import Ints, Nominal

_ROWS_HZ = 5.0
"""Rate at which trials are laid out, below."""
_UP = np.linspace(0.0, 1.0, 12)[1:-1]
_CYCLE = np.concatenate([_UP, np.ones(9), _UP[::-1], np.zeros(4)])
_HOLD = np.concatenate([np.linspace(0.0, 1.0, 6)[1:], np.ones(120), np.zeros(80)])
_REST_ROWS, _SWEEP_ROWS, _MOVE_ROWS, _STAY_ROWS = 20, 440, 20, 5
_STRAIGHT_N, _POSED_N = (30.0, 75.0), (20.0, 60.0)
"""Peak loads on the laboratory arm; another one bears more or less, see `_schedule`."""
_SWEEP_DEG, _POSE_DEG = (6.0, 9.5), (3.0, 9.0)
_HISTORY_KNOTS, _HISTORY_ROWS, _HISTORY_DEG = 6, 8, 6.0


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


def draw_schedule(nominal: Nominal, rng: np.random.Generator) -> Schedule:
    """The trials, 25 for four segments, with loads, orders and poses of this recording's own.

    The loads on a segment act in turn near its joint, at its contact point and far out, in an
    order of their own.
    """
    count = nominal.segment_count
    angles, segments = 2 * count, range(1, count + 1)
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
    near, far = nominal.reach_m.T
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
    for angle, own in enumerate(rows):
        height = np.deg2rad(rng.uniform(*_SWEEP_DEG)) * rng.choice([-1.0, 1.0])
        commands[own, angle] = height * np.sin(2.0 * np.pi * np.arange(1, len(own) + 1) / len(own))
    return commands


def _oblique_n(rng: np.random.Generator) -> Array:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return rng.uniform(*_POSED_N) * np.array([0.0, np.sin(angle), np.cos(angle)])
