"""The unloaded state: measured at one command, carried to others, undone, and its drift."""

from types import SimpleNamespace

import numpy as np
import pytest
from arm_at_rest import BENT, PERIOD_NS, STRAIGHT, Arm
from arm_variants import variant
from estimation_settings import estimation_settings

from cablesense_msgs_py.messages import Level
from cablesense_online.stated_contacts import RestingArm
from cablesense_online.tare import DriftWatch, TareError, Tares
from cablesense_sim.arm import open_arm

pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark

NOW_NS = 1_700_000_000_000_000_000
ZERO = np.zeros(1)
OFFSET = np.array([0.5, -1.0, 2.0])


def predict(command_rad):
    return 50.0 + 100.0 * np.array([1.0, -0.5, 0.2]) * command_rad[0]


def model(samples=4, predict_n=predict, incomplete="", **changes):
    """Of a stand-in arm with one joint and three cables."""
    plain = {"tare_samples": samples, "tare_steady_n": 0.5, "auto_tare": False}
    stand_in = SimpleNamespace(predict_n=predict_n, incomplete=incomplete)
    return Tares(stand_in, estimation_settings(**plain | changes), ZERO)


def feed(tare, readings_n, count=4):
    for _ in range(count):
        tare.add(readings_n)


def test_undo_goes_back_step_by_step_also_at_another_command():
    tare = model()
    feed(tare, predict([0.0]) + OFFSET)
    tare.take(ZERO, NOW_NS)
    feed(tare, predict([0.0]) + 3 * OFFSET)
    tare.take(ZERO, NOW_NS)
    tare.command(np.array([0.1]))
    assert tare.undoable == 2
    assert tare.undo() is tare.present
    assert tare.undoable == 1
    np.testing.assert_allclose(tare.unloaded_n, predict([0.1]) + OFFSET)
    assert tare.undo() is None
    assert tare.unloaded_n is None
    with pytest.raises(TareError, match="nothing to undo"):
        tare.undo()


def test_too_few_or_unsteady_readings_are_refused():
    tare = model()
    feed(tare, predict([0.0]), 3)
    tare.command(np.array([0.1]))
    assert tare.refusal()
    with pytest.raises(TareError, match="only 0 of 4"):
        tare.take(ZERO, NOW_NS)
    for push in (0.0, 2.0, 4.0, 6.0):
        tare.add(predict([0.1]) + np.array([0.0, push, 0.0]))
    with pytest.raises(TareError, match=r"cable_2 varies by 2\.24 N"):
        tare.take(ZERO, NOW_NS)
    assert tare.present is None


def judging(automatic=False, incomplete=""):
    return model(incomplete=incomplete, tare_deviation_n=1.5, auto_tare=automatic)


def test_readings_far_from_the_model_are_refused_with_the_figure_unless_forced():
    tares = judging()
    feed(tares, predict([0.0]) + OFFSET)
    with pytest.raises(TareError, match=r"cable_3 lies \+2\.0 N .*at most 1\.5 N.*tare_force"):
        tares.take(ZERO, NOW_NS)
    assert tares.present is None
    tares.take(ZERO, NOW_NS, forced=True)
    status = tares.status()
    assert (status.level, "2.0 N from the arm file" in status.message) == (Level.WARN, True)


def test_an_arm_whose_file_lists_more_than_the_model_has_is_not_judged_by_it():
    tares = judging(incomplete="of effects")
    feed(tares, predict([0.0]) + OFFSET)
    assert tares.take(ZERO, NOW_NS).offset_n == pytest.approx(2.0)
    assert tares.status().level is Level.OK
    friction = {"effect": "capstan_friction", "at": "arm", "parameters": {"coefficient": 0.1}}
    zero = {"effect": "cable_tolerance", "at": "cable_1", "parameters": {"zero_n": 0.3}}
    assert not RestingArm(variant({"effects": [zero]}), 1).incomplete
    assert RestingArm(variant({"effects": [zero, friction]}), 1).incomplete


@pytest.mark.parametrize(
    ("by_itself", "first", "angle_rad", "dropped"),
    [
        (True, True, 0.1, True),
        (True, True, 0.001, False),
        (True, False, 0.1, False),
        (False, True, 0.1, False),
    ],
)
def test_a_first_command_elsewhere_drops_the_automatic_tare(by_itself, first, angle_rad, dropped):
    tares = judging()
    feed(tares, predict([0.0]))
    tare = tares.take(ZERO, NOW_NS, by_itself=by_itself)
    assert tares.command(np.array([angle_rad]), first=first) is dropped
    assert (tares.present is None) is dropped
    assert tares.automatic is dropped
    assert dropped or tares.present is tare


ARM = open_arm("cdsm")


@pytest.mark.parametrize(("one", "other"), [(1, 4), (3, 10), (6, 9)])
def test_exchanged_plugs_of_an_untouched_arm_are_named_at_the_tare(one, other):
    unloaded = RestingArm(ARM, 1)
    straight = unloaded.predict_n(np.zeros(8))
    build = np.random.default_rng(one).normal(0.0, 0.2, 12)  # zeros, pretension and masses
    order = np.arange(12)
    order[[one - 1, other - 1]] = other - 1, one - 1
    settings = estimation_settings(tare_samples=4, tare_deviation_n=2.0)
    tares = Tares(unloaded, settings, np.zeros(8))
    feed(tares, straight + build)
    assert tares.take(np.zeros(8), NOW_NS)
    assert "exchanged" not in tares.status().message
    feed(tares, (straight + build)[order])
    with pytest.raises(TareError, match=rf"cable_{one} and cable_{other} look exchanged"):
        tares.take(np.zeros(8), NOW_NS)
    tares.take(np.zeros(8), NOW_NS, forced=True)
    assert f"cable_{one} and cable_{other} look exchanged" in tares.status().message


STD_N = 0.07
ALL = "all"


def watch(limit_n=0.1, incomplete=""):
    """Of the arm `cdsm` with sensors of this noise alone."""
    sensors = ARM.sensors.model_copy(update={"noise_std_n": STD_N, "step_n": 0.0})
    arm = ARM.model_copy(update={"sensors": sensors})
    stand_in = SimpleNamespace(arm=arm, incomplete=incomplete)
    return DriftWatch(stand_in, estimation_settings(tare_samples=50, tare_drift_n=limit_n))


def watched(drift, differences_n, rate_hz=100.0, begin_s=0.0):
    for i, difference_n in enumerate(differences_n):
        drift.add(difference_n, round((begin_s + i / rate_hz) * 1e9), touched=False)
    return drift


def noise(count, seed=0):
    return np.random.default_rng(seed).normal(0.0, STD_N, (count, 12))


@pytest.mark.parametrize("rate_hz", [5.0, 1000.0])
def test_noise_alone_is_no_drift(rate_hz):
    for seed in range(2):
        drift = watched(watch(), noise(3000, seed), rate_hz)
        assert drift.status().level is Level.OK


def test_a_contact_is_no_drift_and_single_false_ones_do_not_hide_it():
    drift = watch()
    for i, difference_n in enumerate(0.5 + noise(400)):
        drift.add(difference_n, i * 10_000_000, touched=True)
    assert drift.status().level is Level.OK
    for i, difference_n in enumerate(0.5 + noise(400)):
        drift.add(difference_n, (400 + i) * 10_000_000, touched=i % 3 == 0)
    assert drift.status().level is Level.WARN


def drifted(arm, cable, drift_n):
    reading = arm.reading()
    reading[slice(None) if cable is ALL else cable] += drift_n
    return arm.sample(reading)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "command", "cable"),
    [("cdsm", STRAIGHT, 5), ("cdsm", BENT, ALL), ("cdsm_moving", BENT, 5)],
)
def test_a_slow_drift_of_an_untouched_arm_is_warned_of_before_it_makes_forces(
    model, command, cable
):
    arm = Arm("cdsm", command, model=model, tare_drift_n=0.1)
    for drift_n in np.arange(0.0, 0.3, 0.02 * PERIOD_NS * 1e-9):
        assert drifted(arm, cable, drift_n).contact.magnitude_n < 0.5
        if arm.estimation.drift.status().level is Level.WARN:
            break
    assert 0.05 < drift_n < 0.2
    which = "most cables" if cable is ALL else f"(cable_{cable + 1})"
    assert which in arm.estimation.drift.status().message
    for faster_n in np.arange(drift_n, 6.0, 0.02) if not model.endswith("moving") else ():
        assert drifted(arm, cable, faster_n).contact.magnitude_n < 1.0
