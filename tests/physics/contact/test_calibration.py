"""An arm that is not its file: what unloaded readings teach, and when they are refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from cablesense_contact.calibration import CalibrationError, Calibrator, Unloaded
from cablesense_contact.calibration_file import (
    calibration_bytes,
    calibration_of,
    prior_notes,
    read_calibration,
    write_calibration,
)
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.slides import Belief
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.built import BuiltArm, Workmanship
from cablesense_sim.arm import open_arm
from cablesense_training.law.build import TorchLaw

FRICTIONLESS = {"friction_coefficient": 0.0}
BEND_RAD = np.deg2rad(8.0)
COUNT = 50


def frictionless(name):
    arm = open_arm(name)
    tolerances = arm.tolerances.model_copy(update=FRICTIONLESS)
    return arm.model_copy(update={"tolerances": tolerances})


ARM = frictionless("cdsm_lab")
NOMINAL = read_nominal(Path("config/arms/cdsm_lab.yaml"))


@pytest.fixture(scope="module")
def calibrator():
    return Calibrator(FeltArm(ARM), TorchLaw(ARM))


def built(seed, **changes):
    return BuiltArm(NOMINAL, replace(Workmanship(), **changes), np.random.default_rng(seed))


def unloaded(arm, commands, rng, taken_ns=0):
    tensions = arm.rests(commands, [()] * len(commands)).tensions_n
    means = [arm.read(np.tile(tension, (COUNT, 1)), rng).mean(axis=0) for tension in tensions]
    return [
        Unloaded(mean, command, COUNT, taken_ns)
        for mean, command in zip(means, commands, strict=True)
    ]


def poses(count, rng):
    commands = rng.uniform(-BEND_RAD, BEND_RAD, (count, ARM.joint_count))
    commands[0] = 0.0
    return commands


def test_tolerances_are_where_a_calibration_begins(calibrator):
    calibration = calibrator.by_tolerances()
    parameters = calibrator.parameters
    gains = parameters.slices["sensor_gain"]
    np.testing.assert_allclose(calibration.std[gains], ARM.tolerances.sensor_gain_share)
    assert calibrator.determined(calibration) == []
    assert calibration.as_described


def test_unloaded_poses_determine_what_moves_readings_and_say_so(calibrator):
    rng = np.random.default_rng(1)
    arm = built(2)
    calibration = calibrator.from_poses(unloaded(arm, poses(25, rng), rng))
    determined = calibrator.determined(calibration)
    assert "base_tilt of about y" in determined
    assert "segment_length of segment_4" not in determined  # no unloaded reading shows it
    assert calibration.as_described
    # a fresh pose is predicted to a fraction of what tolerances alone leave
    there = unloaded(arm, poses(6, rng)[1:], rng)
    errors = {}
    for name, known in (("before", calibrator.by_tolerances()), ("after", calibration)):
        beliefs = [Belief(known.mean, known.covariance)] * len(there)
        _, innovations = calibrator._linear(beliefs, there)
        errors[name] = np.sqrt(np.mean(innovations**2))
    assert errors["after"] < 0.2 * errors["before"]


def test_deviations_are_as_large_as_errors(calibrator):
    """Over arms, the errors of determined parameters are those that the covariance states."""
    part = calibrator.parameters.slices["pretension"]
    scores = []
    for seed in range(6):
        rng = np.random.default_rng([3, seed])
        arm = built([4, seed])
        calibration = calibrator.from_poses(unloaded(arm, poses(15, rng), rng))
        truth = arm.body.pretension_n - NOMINAL.body.pretension_n
        scores.append(((truth - calibration.mean[part]) / calibration.std[part]) ** 2)
    total = np.sum(scores)
    count = np.size(scores)
    assert chi2.ppf(1e-4, count) < total < chi2.ppf(1.0 - 1e-4, count)


def test_a_loaded_arm_is_no_tare_unless_forced(calibrator):
    rng = np.random.default_rng(5)
    straight = np.zeros(ARM.joint_count)
    tared = calibrator.from_poses(unloaded(built(6), straight[None], rng))
    reading = tared.unloaded[0].reading_n + np.linspace(-8.0, 8.0, ARM.cable_count)
    loaded = Unloaded(reading, straight, COUNT)
    with pytest.raises(CalibrationError, match="not those of the untouched arm"):
        calibrator.updated(tared, loaded)
    assert len(calibrator.updated(tared, loaded, force=True).unloaded) == 2


def hole_two_millimetres_off(body):
    after_m = body.after_m.copy()
    after_m[1, 5, 2] += 0.002
    return replace(body, after_m=after_m)


def test_an_arm_beyond_its_tolerances_is_doubted(calibrator):
    """One hole two millimetres off is no scatter of a workshop."""
    rng = np.random.default_rng(7)
    arm = built(8)
    arm = arm.altered(hole_two_millimetres_off)
    calibration = calibrator.from_poses(unloaded(arm, poses(12, rng), rng))
    assert not calibration.as_described


def test_zeros_drift_from_the_last_unloaded_reading_on(calibrator):
    rng = np.random.default_rng(9)
    straight = np.zeros((1, ARM.joint_count))
    hour_ns = 3_600_000_000_000
    tared = calibrator.from_poses(unloaded(built(10), straight, rng, taken_ns=hour_ns))
    zeros = calibrator.parameters.slices["sensor_zero"]
    later = calibrator.aged(tared, 3 * hour_ns)
    drift_n = 2.0 * ARM.tolerances.drift_n_per_hour
    np.testing.assert_allclose(later.std[zeros], np.hypot(tared.std[zeros], drift_n))
    assert calibrator.aged(tared, hour_ns) is tared


def test_the_last_reading_can_be_taken_back(calibrator):
    rng = np.random.default_rng(11)
    arm = built(12)
    one, two = unloaded(arm, poses(2, rng), rng)
    first = calibrator.updated(calibrator.by_tolerances(), one)
    back = calibrator.without_last(calibrator.updated(first, two))
    # a fit is as exact as its last step, whence it came
    std = np.where(first.std > 0.0, first.std, 1.0)
    np.testing.assert_allclose(back.mean / std, first.mean / std, atol=0.02)
    correlation = back.covariance / np.outer(std, std)
    np.testing.assert_allclose(correlation, first.covariance / np.outer(std, std), atol=0.02)


def test_a_file_holds_the_calibration_and_is_of_one_arm(calibrator, tmp_path):
    rng = np.random.default_rng(13)
    calibration = calibrator.from_poses(unloaded(built(14), poses(3, rng), rng))
    path = tmp_path / "arm.calibration"
    write_calibration(path, calibration)
    again = read_calibration(path, FeltArm(ARM))
    np.testing.assert_array_equal(again.mean, calibration.mean)
    np.testing.assert_array_equal(again.covariance, calibration.covariance)
    assert again.chi2 == calibration.chi2
    assert [one.count for one in again.unloaded] == [COUNT] * 3
    with pytest.raises(CalibrationError, match="not of cdsm-"):
        read_calibration(path, FeltArm(open_arm("cdsm")))


@pytest.mark.parametrize("cut", [0, 10, 500, -10])
def test_a_damaged_file_is_refused_in_one_line(calibrator, cut):
    content = calibration_bytes(calibrator.by_tolerances())[:cut]
    with pytest.raises(CalibrationError, match="no calibration file") as refused:
        calibration_of(content, FeltArm(ARM), "arm.calibration")
    assert "\n" not in str(refused.value)


def test_a_calibration_knows_whether_a_file_states_the_tolerances_that_it_rests_on(calibrator):
    made = calibrator.by_tolerances()
    tolerances = ARM.tolerances.model_copy(update={"hole_radial_m": 2e-4})
    changed = FeltArm(ARM.model_copy(update={"tolerances": tolerances}))
    assert made.rests_on(calibrator.parameters)
    assert not made.rests_on(changed.parameters)
    (note,) = prior_notes(made, changed, "arm.calibration")
    assert note.startswith("arm.calibration: made with other tolerances")
    assert prior_notes(made, FeltArm(ARM), "arm.calibration") == ()
    assert prior_notes(None, changed, "") == ()
    together = made.prior_covariance + 1e-12
    of_a_diagnosis = replace(made, prior_covariance=together)
    assert of_a_diagnosis.rests_on(changed.parameters)
