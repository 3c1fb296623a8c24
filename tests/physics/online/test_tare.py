"""The unloaded state: when a tare is taken, what it changes, and how it is taken back."""

import numpy as np
import pytest
from estimation_settings import estimation_settings

from cablesense_online.tare import CalibratedArm, TaredArm, TareError, tare_undone_line
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_training.law.build import TorchLaw

ARM = open_arm("cdsm_lab")
MECHANISM = mechanism_of(ARM)
STRAIGHT = np.zeros(8)
BENT = np.deg2rad([4.0, -5.0, 3.0, 6.0, -4.0, 2.0, 5.0, -3.0])
SETTINGS = estimation_settings()
NOW_NS = 10**18


@pytest.fixture(scope="module")
def law():
    return TorchLaw(ARM)


def tensions(command_rad):
    return solve_equilibrium(MECHANISM, command_rad).tensions_n


def filled(arm, command_rad, off_n=0.0):
    arm.at(command_rad)
    for _ in range(SETTINGS.tare_samples):
        arm.add((tensions(command_rad) + off_n).tolist())
    return arm


def test_a_tare_needs_enough_steady_readings_at_one_pose(law):
    arm = CalibratedArm(ARM, law, SETTINGS)
    arm.at(STRAIGHT)
    assert "only 0 of 5 usable readings" in arm.refusal()
    for k in range(5):
        arm.add((tensions(STRAIGHT) + 3.0 * (k % 2)).tolist())
    assert "varies by" in arm.refusal()
    filled(arm, STRAIGHT)
    assert arm.refusal() == ""
    arm.at(BENT)
    assert "only 0 of 5 usable readings" in arm.refusal()


def test_a_tare_updates_what_is_known_in_every_pose(law):
    arm = filled(CalibratedArm(ARM, law, SETTINGS), STRAIGHT)
    assert not arm.known
    before = arm.calibration
    tare = arm.take(NOW_NS)
    assert arm.known
    assert tare.unloaded.count == SETTINGS.tare_samples
    zeros = arm.calibrator.parameters.slices["pretension"]
    assert (arm.calibration.std[zeros] < before.std[zeros]).all()
    filled(arm, BENT).take(NOW_NS + 10**9)
    assert len(arm.calibration.unloaded) == 2
    assert "2 tares" in arm.status().message


def test_readings_of_a_loaded_arm_are_refused_with_what_they_would_mean(law):
    arm = filled(CalibratedArm(ARM, law, SETTINGS), STRAIGHT)
    arm.take(NOW_NS)
    filled(arm, STRAIGHT, np.eye(12)[4] * 20.0)
    with pytest.raises(TareError, match="cable_5 reads") as refused:
        arm.take(NOW_NS)
    assert "tare_force" in str(refused.value)
    forced = arm.take(NOW_NS, forced=True)
    assert forced.misfit_n[4] == pytest.approx(20.0, abs=1.0)


def test_tares_are_undone_one_by_one(law):
    arm = filled(CalibratedArm(ARM, law, SETTINGS), STRAIGHT)
    first = arm.take(NOW_NS)
    filled(arm, BENT).take(NOW_NS)
    assert arm.undoable == 2
    assert arm.undo() is first
    assert arm.undo() is None
    assert not arm.known
    with pytest.raises(TareError, match="nothing to undo"):
        arm.undo()
    line = tare_undone_line(first, None, ARM.cable_names, 0)
    assert line.endswith("there is none now")


def test_a_loaded_calibration_needs_no_tare_and_can_be_replaced(law):
    tared = filled(CalibratedArm(ARM, law, SETTINGS), STRAIGHT)
    tared.take(NOW_NS)
    known = CalibratedArm(ARM, law, SETTINGS, tared.calibration)
    assert known.known
    assert not known.automatic
    known.load(tared.calibration)
    assert known.undoable == 1


def test_a_tare_taken_by_itself_is_dropped_where_the_pose_was_not_known(law):
    arm = filled(CalibratedArm(ARM, law, SETTINGS), STRAIGHT)
    arm.take(NOW_NS, by_itself=True)
    assert arm.drop_own()
    assert arm.automatic
    filled(arm, STRAIGHT).take(NOW_NS)
    assert not arm.drop_own()


def test_cables_that_have_moved_since_the_untouched_arm_carry_friction(law):
    arm = filled(CalibratedArm(ARM, law, SETTINGS), STRAIGHT)
    arm.take(NOW_NS)
    arm.at(BENT)
    carried = arm.calibrator.parameters.slices["carried_friction_0"]
    coefficient = arm.calibration.mean[-1]
    reading = tensions(BENT)
    for _ in range(5):
        arm.untouched(reading)
    pulled = arm.belief(reading + np.eye(12)[2] * 4.0 - np.eye(12)[7] * 4.0, NOW_NS)
    np.testing.assert_allclose(pulled.mean[carried][[2, 7]], [coefficient, -coefficient])
    freed = arm.belief(reading, NOW_NS, freed=True)
    assert np.abs(freed.mean[carried]).max() == 0.0
    unknown = arm.calibrator.moved(arm.calibration).covariance[carried, carried]
    assert (np.diagonal(freed.covariance[carried, carried]) < 0.01 * np.diagonal(unknown)).all()


def test_the_sensors_zeros_drift_with_the_time_since_the_last_tare(law):
    arm = filled(CalibratedArm(ARM, law, SETTINGS), STRAIGHT)
    arm.take(NOW_NS)
    zeros = arm.calibrator.parameters.slices["sensor_zero"]
    now = np.diagonal(arm.belief(tensions(STRAIGHT), NOW_NS).covariance)[zeros]
    hour_later = NOW_NS + 3_600_000_000_000
    later = np.diagonal(arm.belief(tensions(STRAIGHT), hour_later).covariance)[zeros]
    np.testing.assert_allclose(later - now, ARM.tolerances.drift_n_per_hour**2, rtol=1e-6)


def test_a_network_gets_the_tare_carried_to_the_pose_by_the_arm_file():
    offsets_n = np.linspace(-1.0, 1.0, 12)
    arm = TaredArm(ARM, SETTINGS.model_copy(update={"tare_deviation_n": 2.0}))
    filled(arm, STRAIGHT, offsets_n)
    arm.take(NOW_NS)
    arm.at(BENT)
    np.testing.assert_allclose(arm.unloaded_n(), tensions(BENT) + offsets_n, atol=1e-6)
    filled(arm, BENT, 5.0 * np.ones(12))
    with pytest.raises(TareError, match=r"cable_\d+ lies \+5\.0 N"):
        arm.take(NOW_NS)
