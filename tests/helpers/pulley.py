"""A winch, a cable over a pulley, and a weight on a spring: a mechanism that is no arm.

The winch takes in cable (k1 from winch to pulley), which runs over a fixed pulley and holds a
weight (k2 from pulley to weight) that a spring ties to the floor. With s the cable that has passed
the pulley and v what the winch has taken in,

    T1 = k1 (v - s),    T2 = a s + b,    a = k2 k_s / (k2 + k_s),  b = k2 (W + F) / (k2 + k_s),

and the pulley's friction keeps s where it is while T1 / T2 is within exp(±μ π) (Euler, Eytelwein):
of the s that this allows, the one nearest to the last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.problem import Problem, prepare
from cablesense_gap.simulator import Assignment, Candidate, Term, parameters_of
from cablesense_gap.system import System
from cablesense_sim.effects.effect import Parameter

G_M_S2 = 9.81
WEIGHT_KG = 5.0
NEAR_N_M = 20e3
FAR_N_M = 5e3
SPRING_N_M = 400.0
WRAP_RAD = np.pi
NOISE = np.array([0.05, 0.05, 1e-4])
"""Of the force at the winch, N, that at the weight, N, and the weight's height, m."""

PERIOD_S = 0.5
ROWS = 24
FORCES = ("force_at_winch", "force_at_weight")

Size = tuple[str, str, float, float, float]


def _effect(
    name: str,
    places: Sequence[str],
    size: Size,
    *shapes: Parameter,
    history_dependent: bool = False,
) -> Candidate:
    return Candidate(name, tuple(places), (Parameter(*size, name), *shapes), history_dependent)


TIME_S = Parameter(
    "time_s",
    "s",
    0.5,
    100.0,
    5.0,
    "until 63 % is there",
    default=5.0,
    role="shape",
    starts=(2.0, 12.0),
)
CANDIDATES = (
    _effect(
        "pulley_friction", ["pulley"], ("coefficient", "1", 0.0, 0.4, 0.05), history_dependent=True
    ),
    _effect(
        "cable_creep", ["cable"], ("share", "1", 0.0, 2.0, 0.2), TIME_S, history_dependent=True
    ),
    _effect("sensor_gain", ["arm", *FORCES], ("gain", "1", -0.3, 0.3, 0.03)),
    _effect("sensor_offset", FORCES, ("zero_n", "N", -20.0, 20.0, 1.0)),
    _effect("softer_cable", ["cable"], ("compliance", "1", -0.5, 2.0, 0.2)),
    _effect("extra_weight", ["weight"], ("mass_kg", "kg", -2.0, 2.0, 0.2)),
)
TOLERANCES = (
    _effect("zeros", FORCES, ("zero_n", "N", -0.5, 0.5, 0.05)),
    _effect("weighing", ["weight"], ("mass_kg", "kg", -0.1, 0.1, 0.01)),
    _effect("make", ["cable"], ("compliance", "1", -0.02, 0.02, 0.004)),
)


@dataclass(frozen=True)
class Work:
    """What is done to it: (R,) winch and known load, and the trial of each row."""

    wound_m: Array
    load_n: Array
    trial: np.ndarray


def work(seed: int = 0, trials: int = 12) -> Work:
    """In turn the winch goes round, the load goes round at one winch, and a load is held."""
    rng = np.random.default_rng(seed)
    turn = np.sin(np.linspace(0.0, 2.0 * np.pi, ROWS))
    hold = np.repeat([0.0, 1.0, 0.0], [4, 12, ROWS - 16])
    wound = []
    load = []
    for t in range(trials):
        size = rng.uniform(0.4, 1.0)
        offset = rng.uniform(-0.02, 0.02)
        wound.append(0.05 * size * turn if t % 3 == 0 else np.full(ROWS, offset))
        push = (0.0 * turn, 25.0 * size * (1.0 + turn), 50.0 * size * hold)[t % 3]
        load.append(push)
    return Work(
        0.1 + np.concatenate(wound), np.concatenate(load), np.repeat(np.arange(trials), ROWS)
    )


class Pulley:
    """A `Simulator`; its channels are in units of their sensors' noise."""

    floor = 1.0

    def __init__(
        self,
        done: Work,
        candidates: Sequence[Candidate] = CANDIDATES,
        tolerances: Sequence[Candidate] = TOLERANCES,
    ) -> None:
        self.candidates = candidates
        self.tolerances = tolerances
        self._done = done

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Force at the winch, force at the weight and height (P, R, 3), each over its noise."""
        soft = 1.0 + sum(_of(variants, effect, "cable", "compliance") for effect in SOFT)
        mass = WEIGHT_KG + sum(_of(variants, effect, "weight", "mass_kg") for effect in HEAVY)
        near, far, height = self._at_rest(NEAR_N_M / soft, FAR_N_M / soft, G_M_S2 * mass, variants)
        channels = np.stack([near, far, height], axis=-1) / NOISE
        for c, where in enumerate(FORCES):
            gain = sum(_of(variants, "sensor_gain", at, "gain") for at in ("arm", where))
            zero = sum(_of(variants, effect, where, "zero_n") for effect in SHIFTED)
            channels[..., c] = channels[..., c] * (1.0 + gain[:, None]) + zero[:, None] / NOISE[c]
        return channels

    def _at_rest(
        self, near_n_m: Array, far_n_m: Array, weight_n: Array, variants: Sequence[Assignment]
    ) -> tuple[Array, Array, Array]:
        held = np.exp(WRAP_RAD * _of(variants, "pulley_friction", "pulley", "coefficient"))
        share = _of(variants, "cable_creep", "cable", "share")
        late = np.exp(-PERIOD_S / _of(variants, "cable_creep", "cable", "time_s", 5.0))
        a = far_n_m * SPRING_N_M / (far_n_m + SPRING_N_M)
        passed: Array | None = None
        crept = np.zeros(len(variants))
        rows = []
        for wound, load in zip(self._done.wound_m, self._done.load_n, strict=True):
            pulled = wound - crept
            b = far_n_m * (weight_n + load) / (far_n_m + SPRING_N_M)
            least, even, most = (
                (near_n_m * pulled - e * b) / (near_n_m + e * a) for e in (held, 1.0, 1.0 / held)
            )
            passed = even if passed is None else np.clip(passed, least, most)
            near = near_n_m * (pulled - passed)
            far = a * passed + b
            crept = late * crept + (1.0 - late) * share * near / near_n_m
            rows.append((near, far, passed - far / far_n_m))
        near, far, height = np.moveaxis(np.array(rows), 0, -1)
        return near, far, height


SOFT = ("softer_cable", "make")
HEAVY = ("extra_weight", "weighing")
SHIFTED = ("sensor_offset", "zeros")


def _of(
    variants: Sequence[Assignment], effect: str, place: str, parameter: str, default: float = 0.0
) -> Array:
    term = Term(effect, place, parameter)
    return np.array([variant.get(term, default) for variant in variants])


def recorded(truth: Assignment, seed: int = 0, done: Work | None = None) -> tuple[Pulley, Array]:
    """A pulley with its readings (R, 3), with noise and what a workshop leaves."""
    simulator = Pulley(work(seed) if done is None else done)
    rng = np.random.default_rng([seed, 1])
    tolerances = parameters_of(simulator.tolerances)
    scatter = {term: float(rng.normal(0.0, each.typical)) for term, each in tolerances.items()}
    ideal = simulator.predict([{**scatter, **truth}])[0]
    return simulator, ideal + rng.normal(0.0, simulator.floor, ideal.shape)


def problem_of(simulator: Pulley, readings: Array, folds: int = 4) -> Problem:
    """All rows count; trials of one kind are dealt to the folds in turn."""
    trial = simulator._done.trial
    fold = np.arange(trial.max() + 1) // 3 % folds
    return prepare(simulator, readings, trial, fold, np.ones(len(trial), dtype=bool))


class PulleySystem(Pulley, System):
    """The pulley with its readings (R, 3), for the whole pipeline."""

    name = "pulley"
    recording_name = "work"
    unit = "floors"

    def __init__(self, done: Work, readings: Array) -> None:
        super().__init__(done)
        self.readings = readings
        self.trial = done.trial
        self.recorded_row_count = len(readings)
        self.fold = np.arange(done.trial.max() + 1) // 3 % 4
        self.counted = np.ones(len(readings), dtype=bool)
