"""The history-dependent estimator: its ticks, its state, and its answers."""

import numpy as np
import pytest

from cablesense_sim.arm import open_arm
from cablesense_training.errors import EstimateError
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.temporal_estimator import (
    LONGEST_GAP_S,
    TemporalEstimator,
    open_estimator,
)

CDSM = open_arm("cdsm")
STILL = np.zeros(8)


@pytest.fixture
def estimator():
    return TemporalEstimator.load(find_model("cdsm_moving"), CDSM)


@pytest.fixture(scope="module")
def course():
    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.normal(0.0, 1.0, (60, 12)), axis=0)
    angles = 0.1 * np.sin(np.linspace(0.0, 3.0, 60))[:, None] * np.ones(8)
    speeds = np.gradient(angles, 0.02, axis=0)
    return walk, angles, speeds, np.gradient(speeds, 0.02, axis=0)


def _through(estimator, course, times):
    return [
        estimator.estimate(*(part[row] for part in course), time) for row, time in enumerate(times)
    ]


def _bytes(estimates):
    return [np.concatenate([e.probabilities, e[2:8]]).tobytes() for e in estimates]


def test_the_same_samples_after_forgetting_give_the_same_bytes(estimator, course):
    times = 100.0 + 0.02 * np.arange(60)
    first = _bytes(_through(estimator, course, times))
    estimator.forget()
    assert _bytes(_through(estimator, course, times)) == first
    goes_on = _bytes(_through(estimator, course, times[-1] + 0.02 * np.arange(1, 61)))
    assert goes_on != first  # the past counts


def test_samples_between_ticks_are_answered_and_leave_the_state_alone(estimator, course):
    ticks = 0.02 * np.arange(60)
    plain = _through(estimator, course, ticks)
    estimator.forget()
    tension, *rest = course
    for row, time in enumerate(ticks):
        setpoint = [part[row] for part in rest]
        answer = estimator.estimate(tension[row], *setpoint, time)
        assert answer.magnitude_n == plain[row].magnitude_n
        estimator.estimate(tension[row] + 1.0, *setpoint, time + 0.005)
        estimator.estimate(tension[row] - 1.0, *setpoint, time + 0.010)


@pytest.mark.parametrize("rate_hz", [250, 1000])
def test_however_often_samples_come_the_memory_goes_at_its_own_rate(estimator, course, rate_hz):
    still = [part[30] for part in course]
    by_tick = _bytes(estimator.estimate(*still, time) for time in 0.02 * np.arange(20))
    estimator.forget()
    ticks, last = [], None
    for sample in range(rate_hz // 4):
        answer = _bytes([estimator.estimate(*still, sample / rate_hz)])[0]
        ticks += [answer] if answer != last else []
        last = answer
    assert ticks[:12] == by_tick[:12]
    assert len(ticks) <= 14


@pytest.mark.parametrize("leap_s", [-0.5, LONGEST_GAP_S + 0.1])
def test_a_leap_of_time_begins_a_new_past(estimator, course, leap_s):
    _through(estimator, course, 0.02 * np.arange(60))
    after = _through(estimator, course, 1.18 + leap_s + 0.02 * np.arange(60))
    estimator.forget()
    assert _bytes(after) == _bytes(_through(estimator, course, 0.02 * np.arange(60)))


def test_a_wrong_shape_or_a_number_that_is_none_is_refused_and_remembered_by_no_one(
    estimator, course
):
    first = _through(estimator, course, 0.02 * np.arange(60))
    estimator.forget()
    with pytest.raises(EstimateError, match="this model needs 12"):
        estimator.estimate(np.zeros(11), STILL, STILL, STILL, 0.0)
    with pytest.raises(EstimateError, match="must be finite"):
        estimator.estimate(np.full(12, np.nan), STILL, STILL, STILL, 0.0)
    assert _bytes(_through(estimator, course, 0.02 * np.arange(60))) == _bytes(first)


def test_each_kind_of_model_is_opened_as_what_it_is():
    assert isinstance(open_estimator(find_model("cdsm_moving"), CDSM), TemporalEstimator)
    assert isinstance(open_estimator(find_model("cdsm"), CDSM), Estimator)
