"""What a recording teaches of what its model leaves: of another one, and of its causes."""

import numpy as np
import pytest

from cablesense_gap.diagnosis.discrepancy import (
    Conditions,
    Discrepancy,
    FlexibleModel,
    SmoothColumns,
    flexible_model,
)

TRIALS = 6
ROWS = 150
NOISE = 0.05
FOLD = np.repeat(np.arange(TRIALS), ROWS)


def moved(seed, reach=1.0):
    """Conditions of two channels in trials of their own sines."""
    rng = np.random.default_rng(seed)
    course = np.linspace(0.0, 1.0, ROWS)[:, None]
    position = []
    speed = []
    for _ in range(TRIALS):
        turns = rng.uniform(2.0, 12.0, 2)
        phase = rng.uniform(0.0, 6.0, 2)
        position.append(reach * np.sin(turns * course + phase))
        speed.append(reach * turns * np.cos(turns * course + phase))
    place = np.concatenate(position)
    load = 3.0 * np.cos(place)
    return Conditions(place, np.concatenate(speed), load, np.zeros_like(place))


def left(conditions, seed, wavy=1.0):
    """What a model lacks that knows neither gears nor bearings that are rough in places."""
    place, speed, *_ = conditions
    rough = 0.5 * (1.0 + np.sin(3.0 * place)) * np.sign(speed)
    noise = np.random.default_rng(seed).normal(0.0, NOISE, place.shape)
    return wavy * (np.sin(9.0 * place) + rough) + noise


def learnt(wavy=1.0):
    conditions = moved(1)
    smooth = SmoothColumns.like(conditions)
    return smooth, Discrepancy(smooth.of(conditions), left(conditions, 2, wavy), FOLD)


def beyond_all(smooth, conditions):
    """By how many margins the conditions leave those of the reference, together."""
    return np.sqrt(sum(each**2 for each in smooth.beyond(conditions)))


def test_what_repeats_is_predicted_and_the_rest_is_as_large_as_stated():
    smooth, discrepancy = learnt()
    again = moved(3)
    residual = left(again, 4)
    expected = discrepancy.of(smooth.of(again), beyond_all(smooth, again))
    off = residual - expected.mean
    assert np.std(off) < 0.15 * np.std(residual)
    assert np.sqrt(((off / expected.deviation) ** 2).mean()) == pytest.approx(1.0, abs=0.4)


def test_places_where_the_reference_has_not_been_are_less_certain():
    smooth, discrepancy = learnt()
    far = moved(3, reach=1.5)
    deviation = discrepancy.of(smooth.of(far), beyond_all(smooth, far)).deviation
    unseen = np.abs(far.position) > 1.2
    assert np.median(deviation[unseen]) > 5.0 * np.median(deviation[~unseen])


def explained(residual) -> FlexibleModel:
    """By a level, and by the way a machine moves; its conditions say nothing."""
    features = {"level": {"level of one": LEVEL, "level of other": LEVEL**2}, "way": {"way": WAY}}
    noise = RNG.normal(0.0, NOISE, (len(FOLD), 2))
    still = Conditions(*(np.ones_like(noise) for _ in Conditions._fields))
    return flexible_model(features, still, residual + noise, FOLD, 0.9 * NOISE)


RNG = np.random.default_rng(11)
LEVEL = RNG.uniform(-2.0, 2.0, len(FOLD))
WAY = np.sign(np.sin(np.arange(len(FOLD)) / 4.0))


def test_the_group_of_features_that_explains_a_residual_is_told():
    found = explained(np.outer(LEVEL, [1.0, -0.5]))
    assert found.explained_share > 0.9
    assert found.alone["level"] > 0.9
    assert found.alone["way"] < 0.1
    assert found.foremost == "level of one"
    assert explained(np.outer(WAY, [0.0, 0.5])).alone["way"] > 0.9


def test_noise_and_what_differs_from_trial_to_trial_are_not_explained():
    assert explained(np.zeros(2)).explained_share < 0.1
    assert explained(RNG.normal(size=TRIALS)[FOLD][:, None]).explained_share < 0.2
