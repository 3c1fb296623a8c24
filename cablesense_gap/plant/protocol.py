"""What is done to a plant while it is recorded: trials of rests, loads, poses and holds."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.plant.body import Ints, Nominal

_UP = np.linspace(0.0, 1.0, 12)[1:-1]
_CYCLE = np.concatenate([_UP, np.ones(9), _UP[::-1], np.zeros(4)])
_HOLD = np.concatenate([np.linspace(0.0, 1.0, 6)[1:], np.ones(120), np.zeros(80)])
_REST_ROWS, _SWEEP_ROWS, _MOVE_ROWS, _STAY_ROWS = 20, 440, 20, 5
_STRAIGHT_N, _POSED_N = (30.0, 75.0), (20.0, 60.0)
"""Peak loads on the laboratory arm; another one bears more or less, by `_strength`."""
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
    """

    time_s: Array
    trial: Ints
    command_rad: Array
    load_segment: Ints
    load_n: Array

    @property
    def forces_n(self) -> Array:
        """(R, N, 3) the load as one force per segment."""
        segments = np.arange(1, self.command_rad.shape[1] // 2 + 1)
        return (self.load_segment[:, None] == segments)[..., None] * self.load_n[:, None]

    def rows(self, chosen: slice) -> Schedule:
        """The chosen rows."""
        return Schedule._make(column[chosen] for column in self)


class _Script:
    """Gathers trials."""

    def __init__(self, nominal: Nominal) -> None:
        self.strength = _strength(nominal)
        self.angles = 2 * nominal.segment_count
        self.period_s = 1.0 / nominal.rate_hz
        self.commands: list[Array] = []
        self.segments: list[Ints] = []
        self.loads: list[Array] = []

    def trial(self, commands: Array, segment: int = 0, loads: Array | None = None) -> None:
        load = np.zeros((len(commands), 3))
        if loads is not None:
            load = np.round(self.strength * loads, 3) + 0.0
        self.commands.append(np.round(commands, 6) + 0.0)
        self.loads.append(load)
        self.segments.append(np.where((load != 0.0).any(axis=1), segment, 0))

    def pushed(self, pose: Array, segment: int, peak_n: Array, shape: Array) -> None:
        self.trial(np.tile(pose, (len(shape), 1)), segment, shape[:, None] * peak_n)

    def schedule(self) -> Schedule:
        rows = [len(commands) for commands in self.commands]
        return Schedule(
            time_s=self.period_s * np.arange(sum(rows), dtype=float),
            trial=np.repeat(np.arange(len(rows)), rows),
            command_rad=np.concatenate(self.commands),
            load_segment=np.concatenate(self.segments),
            load_n=np.concatenate(self.loads),
        )


def draw_schedule(nominal: Nominal, rng: np.random.Generator) -> Schedule:
    """The trials, 25 for four segments, with loads, orders and poses of this recording's own."""
    count = nominal.segment_count
    segments = np.arange(1, count + 1)
    script = _Script(nominal)
    straight = np.zeros(script.angles)
    script.trial(np.tile(straight, (_REST_ROWS, 1)))
    sides = np.array([[0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    for segment in segments:
        for side in rng.permutation(len(sides))[: max(1, 12 // count)]:
            peak = rng.uniform(*_STRAIGHT_N) * sides[side]
            script.pushed(straight, int(segment), peak, _CYCLE)
    script.trial(_sweep(script.angles, rng))
    pose = np.deg2rad(rng.uniform(*_POSE_DEG)) * rng.uniform(-1.0, 1.0, script.angles)
    ease = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, _MOVE_ROWS + 1) / _MOVE_ROWS)
    script.trial(np.outer(np.concatenate([ease, np.ones(_STAY_ROWS)]), pose))
    for segment in segments:
        script.pushed(pose, int(segment), _oblique_n(rng), _CYCLE)
    held_segment = int(rng.integers(min(2, count), count + 1))
    script.pushed(pose, held_segment, _oblique_n(rng), _HOLD)
    script.trial(np.outer(ease[::-1] - ease[0], pose))
    for segment in rng.permutation(segments):
        script.pushed(straight, int(segment), _oblique_n(rng), _CYCLE)
    return script.schedule()


def draw_history(nominal: Nominal, rng: np.random.Generator) -> Schedule:
    """Moves and pushes that an arm went through before its first row, and that are not recorded.

    It ends straight and unloaded, where every recording begins.
    """
    script = _Script(nominal)
    size = np.linspace(1.0, 0.0, _HISTORY_KNOTS)[:, None]
    knots = np.deg2rad(_HISTORY_DEG) * size * rng.uniform(-1.0, 1.0, (1, script.angles))
    knots = knots * rng.uniform(-1.0, 1.0, (_HISTORY_KNOTS, script.angles))
    for start, end in pairwise(knots):
        share = np.linspace(0.0, 1.0, _HISTORY_ROWS)[:, None]
        segment = int(rng.integers(1, nominal.segment_count + 1))
        bump = np.sin(np.pi * share) * _oblique_n(rng) * rng.uniform(0.0, 1.0)
        script.trial(start + share * (end - start), segment, bump)
    script.trial(np.zeros((2, script.angles)))
    past = script.schedule()
    return past._replace(time_s=past.time_s - len(past.time_s) * script.period_s)


def _strength(nominal: Nominal) -> float:
    """Load that the cables can hold at the arm's reach, by that of the laboratory arm."""
    moment_nm = nominal.pretension_n * nominal.radius_m * nominal.cable_count
    return moment_nm / (nominal.segment_count * nominal.length_m) / (50.0 * 0.05 * 12 / (4 * 0.13))


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
