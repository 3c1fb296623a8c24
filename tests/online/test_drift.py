"""Drift of the unloaded tensions is found over the time without contact, whatever its pattern."""

import numpy as np
import pytest
from arm_at_rest import BENT, PERIOD_NS, STRAIGHT, Arm
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_msgs_py.messages import Level, Load
from cablesense_online.drift import DriftWatch
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_sim.dynamics import ArmDynamics

pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark

NAMES = [f"cable_{number}" for number in range(1, 13)]
STD_N = 0.07
ALL = "all"


def watch(limit_n=0.1, **changes):
    return DriftWatch(limit_n, STD_N, 50, NAMES, **changes)


def fed(drift, differences_n, rate_hz=100.0, begin_s=0.0):
    for i, difference_n in enumerate(differences_n):
        drift.add(difference_n, round((begin_s + i / rate_hz) * 1e9), touched=False)
    return drift


def noise(count, seed=0):
    return np.random.default_rng(seed).normal(0.0, STD_N, (count, 12))


@given(st.lists(st.floats(-3.0, 3.0), min_size=12, max_size=12), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_its_size_is_found_and_only_what_exceeds_the_limit_is_warned_of(offsets, seed):
    drift = fed(watch(), np.array(offsets) + noise(160, seed))
    np.testing.assert_allclose(drift.drift_n, offsets, atol=0.06)
    largest_n = np.abs(drift.drift_n).max()
    assert (drift.status().level is Level.WARN) == (largest_n >= drift.limit_n)
    assert largest_n <= np.abs(offsets).max() + 0.04


@pytest.mark.parametrize("rate_hz", [5.0, 1000.0])
def test_noise_alone_is_no_drift(rate_hz):
    for seed in range(4):
        drift = fed(watch(), noise(3000, seed), rate_hz)
        assert drift.status().level is Level.OK


def test_a_contact_is_no_drift_and_single_false_ones_do_not_hide_it():
    drift = watch()
    for i, difference_n in enumerate(0.5 + noise(400)):
        drift.add(difference_n, i * 10_000_000, touched=True)
    assert drift.status().level is Level.OK
    for i, difference_n in enumerate(0.5 + noise(400)):
        drift.add(difference_n, (400 + i) * 10_000_000, touched=i % 3 == 0)
    assert drift.status().level is Level.WARN


def test_it_stands_in_a_contact_and_goes_with_a_fresh_tare():
    drift = fed(watch(), 0.5 + noise(200))
    drift.interrupt()
    status = drift.status()
    assert status.level is Level.WARN
    assert "most cables" in status.message
    assert "1970-01-01 00:00:00 UTC" in status.message
    assert "call ~/tare" in status.message
    drift.tared()
    assert drift.status().level is Level.OK


@pytest.mark.parametrize(("limit_n", "unwatched"), [(0.0, ""), (0.1, "of effects")])
def test_what_is_not_watched_is_reported_as_such(limit_n, unwatched):
    drift = fed(watch(limit_n, unwatched=unwatched), 5.0 + noise(400))
    assert drift.status().level is Level.OK
    assert f"not watched: {unwatched}" in drift.status().message


def drifted(arm, cable, drift_n):
    reading = arm.reading()
    reading[slice(None) if cable is ALL else cable] += drift_n
    return arm.sample(reading)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["cdsm", "cdsm_moving"])
@pytest.mark.parametrize("command", [STRAIGHT, BENT], ids=["straight", "bent"])
@pytest.mark.parametrize("cable", [5, ALL])
def test_a_slow_drift_of_an_untouched_arm_is_warned_of_before_it_makes_forces(
    model, command, cable
):
    arm = Arm(model.removesuffix("_moving"), command, model=model, tare_drift_n=0.1)
    for drift_n in np.arange(0.0, 0.3, 0.02 * PERIOD_NS * 1e-9):
        assert drifted(arm, cable, drift_n).contact.magnitude_n < 0.5
        if arm.estimation.drift.status().level is Level.WARN:
            break
    assert 0.05 < drift_n < 0.2
    which = "most cables" if cable is ALL else f"(cable_{cable + 1})"
    assert which in arm.estimation.drift.status().message
    for faster_n in np.arange(drift_n, 6.0, 0.02) if not model.endswith("moving") else ():
        assert drifted(arm, cable, faster_n).contact.magnitude_n < 1.0


@pytest.mark.slow
def test_an_arm_that_swings_after_its_loads_has_no_drift():
    arm = Arm("cdsm_lab", tare_drift_n=0.1)
    sim = SimulatedArm(ArmDynamics(arm.arm), 1e-3, 0.35, 0.0, now_s=0.0)
    for tick in range(900):
        now_s = tick * 0.01
        if tick % 300 == 100:
            sim.push(Load(2 + tick // 400, np.array([0.0, 60.0, -30.0])), now_s)
        if tick % 300 == 200:
            sim.push(Load(2 + tick // 400, np.zeros(3)), now_s)
        sim.advance_to(now_s)
        arm.sample(sim.reading_n(arm.arm.sensors, arm.rng))
        assert arm.estimation.drift.status().level is Level.OK
