"""The diagnosis of a mechanism that is no arm: planted effects are found."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cablesense_gap.diagnosis.probability import Ranked, bundled_calibration, posterior
from cablesense_gap.diagnosis.search import search
from cablesense_gap.pipeline import diagnose_system
from cablesense_gap.simulator import Term
from tests.helpers.pulley import FORCES, NOISE, Pulley, PulleySystem, problem_of, recorded, work

pytestmark = pytest.mark.slow


FRICTION = Term("pulley_friction", "pulley", "coefficient")
SHARE, TIME_S = (Term("cable_creep", "cable", name) for name in ("share", "time_s"))
WINCH_GAIN, WEIGHT_GAIN = (Term("sensor_gain", force, "gain") for force in FORCES)
GAIN = Term("sensor_gain", "arm", "gain")
ZERO_N = Term("sensor_offset", FORCES[0], "zero_n")
SOFT = Term("softer_cable", "cable", "compliance")
MASS_KG = Term("extra_weight", "weight", "mass_kg")

WITHIN = {
    FRICTION: 0.001,
    SHARE: 0.04,
    TIME_S: 0.6,
    WINCH_GAIN: 0.001,
    WEIGHT_GAIN: 0.001,
    GAIN: 0.001,
    ZERO_N: 0.2,
    SOFT: 0.02,
    MASS_KG: 0.04,
}
"""Four standard deviations and more, of what the workshop leaves where that is the larger."""

SINGLES = [{FRICTION: 0.08}, {SHARE: 0.6, TIME_S: 4.0}, {GAIN: 0.04}, {MASS_KG: -0.8}]
DOUBLES = [{FRICTION: 0.08, MASS_KG: 0.25}, {SOFT: 0.5, WEIGHT_GAIN: -0.02}]


def named(values: dict[Term, float]) -> str:
    return "+".join(f"{term}={value:g}" for term, value in values.items()) or "none"


def judged(simulator: Pulley, readings: np.ndarray) -> list[Ranked]:
    problem = problem_of(simulator, readings)
    return posterior(search(problem), problem.floor, bundled_calibration())


@cache
def best_of(*truth: tuple[Term, float]) -> Ranked:
    return judged(*recorded(dict(truth)))[0]


@pytest.mark.parametrize("truth", SINGLES + DOUBLES, ids=named)
def test_what_was_planted_is_found_with_right_numbers(truth: dict[Term, float]) -> None:
    best = best_of(*truth.items())
    assert best.effects == tuple(sorted({term.effect for term in truth}))
    assert best.probability > 0.5
    assert best.hypothesis is not None
    for term, value in truth.items():
        assert best.hypothesis.values[term] == pytest.approx(value, abs=WITHIN[term]), term
    for term in best.hypothesis.values.keys() - truth.keys():
        assert best.hypothesis.values[term] == pytest.approx(0.0, abs=WITHIN[term]), term
    assert best.hypothesis.held_out_rmse < 1.2 * Pulley.floor


def test_what_a_workshop_leaves_is_no_effect() -> None:
    best = best_of()
    assert best.effects == ("none",)


def test_an_unlisted_cause_is_unknown_and_no_listed_effect_removes_it() -> None:
    """A winch that pulls harder and softer as its teeth pass."""
    simulator, readings = recorded({})
    teeth = np.sin(2.0 * np.pi * work().wound_m / 0.012)
    ranked = judged(simulator, readings + np.outer(1.5 * teeth, [1.0, 0.0, 0.0]) / NOISE)
    assert ranked[0].effects == ("unknown",)
    assert ranked[0].probability > 0.5
    rmse_of = {b.effects: b.hypothesis.held_out_rmse for b in ranked if b.hypothesis}
    assert min(rmse_of.values()) > 0.8 * rmse_of["none",]


def test_the_amended_simulator_predicts_work_that_it_has_not_seen() -> None:
    truth = DOUBLES[0]
    best = best_of(*truth.items()).hypothesis
    assert best is not None
    new = Pulley(work(seed=77))
    after, before, real = (new.predict([v])[0] for v in (best.values, {}, truth))
    assert np.sqrt(((after - real) ** 2).mean()) < 0.03 * np.sqrt(((before - real) ** 2).mean())


def test_the_pipeline_gives_a_verdict_on_a_machine_that_is_no_arm() -> None:
    truth = {WEIGHT_GAIN: -0.04}
    outcome = diagnose_system(PulleySystem(work(), recorded(truth)[1]))
    assert outcome.verdict.effects == ("sensor_gain",)
    (number,) = outcome.verdict.parameters.values()
    assert number.value == pytest.approx(-0.04, abs=WITHIN[WEIGHT_GAIN])
    assert outcome.verdict.gap.removed_fraction > 0.9
    assert outcome.verdict.gap.floor_n == 1.0


def test_the_search_says_what_it_does_and_how_far_it_is() -> None:
    told: list[tuple[str, float]] = []
    search(problem_of(*recorded({GAIN: 0.04})), lambda what, share: told.append((what, share)))
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert "extra_weight" in [what for what, _ in told]
