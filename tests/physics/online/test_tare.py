"""The unloaded state: when a tare is taken, what it changes, and how it is taken back."""

import re

import numpy as np
import pytest

from benchmarks.estimation_settings import estimation_settings
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_contact.machine.law import MachineLaw
from cablesense_online.calibrated_arm import CalibratedArm
from cablesense_online.contact_estimator import EstimationState
from cablesense_online.motion import MotionGate
from cablesense_online.statuses import tare_status
from cablesense_online.tare import TareError, refusal, tare_undone_line, with_reading
from cablesense_online.tared_arm import TaredArm
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_training.law.build import TorchLaw
from tests.helpers.example_machines import example_machine, machine_of_two_motors
from tests.helpers.torch_stater import TorchStater

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


class Tared:
    """An arm and the present state of what is known of it."""

    def __init__(self, arm, calibration=None):
        self.arm = arm
        self.state = arm.begin(calibration)

    def fill(self, command_rad, off_n=0.0, count=SETTINGS.tare_samples):
        self.state = self.arm.at(self.state, command_rad)
        for _ in range(count):
            self.add(tensions(command_rad) + off_n)
        return self

    def add(self, reading_n):
        self.state = with_reading(self.state, reading_n.tolist(), SETTINGS.tare_samples)

    def take(self, now_ns=NOW_NS, **how):
        self.state = self.arm.taken(self.state, now_ns, **how)
        return self.state.tares[-1]

    def undo(self):
        self.state = self.arm.undone(self.state)

    def belief(self, reading_n, now_ns=NOW_NS, **how):
        self.state, belief = self.arm.belief(self.state, reading_n, now_ns, **how)
        return belief

    @property
    def refusal(self):
        return refusal(self.state, SETTINGS, FeltArm(ARM).channels)


def calibrated(law, calibration=None):
    return Tared(CalibratedArm(FeltArm(ARM), law, SETTINGS), calibration)


def test_a_tare_needs_enough_steady_readings_at_one_pose(law):
    arm = calibrated(law).fill(STRAIGHT, count=0)
    assert "only 0 of 5 usable readings" in arm.refusal
    for k in range(5):
        arm.add(tensions(STRAIGHT) + 3.0 * (k % 2))
    assert " varies by 1.47 N (" in arm.refusal
    said = re.search(r"set tare_steady_n to ([0-9.]+) or more$", arm.refusal)
    accepting = estimation_settings(tare_steady_n=float(said[1]))
    assert refusal(arm.state, accepting, FeltArm(ARM).channels) == ""
    arm.fill(STRAIGHT)
    assert arm.refusal == ""
    arm.fill(BENT, count=0)
    assert "only 0 of 5 usable readings" in arm.refusal


def test_a_tare_updates_what_is_known_in_every_pose(law):
    arm = calibrated(law).fill(STRAIGHT)
    assert not arm.state.known
    before = arm.state.calibration
    tare = arm.take()
    assert arm.state.known
    assert tare.unloaded.count == SETTINGS.tare_samples
    zeros = arm.arm.calibrator.parameters.slices["pretension"]
    assert (arm.state.calibration.std[zeros] < before.std[zeros]).all()
    arm.fill(BENT).take(NOW_NS + 10**9)
    assert len(arm.state.calibration.unloaded) == 2
    estimation = EstimationState(MotionGate(SETTINGS).at_rest(BENT), arm.state)
    assert "2 tares" in tare_status(estimation, "", None).message


def test_readings_of_a_loaded_arm_are_refused_with_what_they_would_mean(law):
    arm = calibrated(law).fill(STRAIGHT)
    arm.take()
    arm.fill(STRAIGHT, np.eye(12)[4] * 20.0)
    with pytest.raises(TareError, match="cable_5 reads") as refused:
        arm.take()
    assert "tare_force" in str(refused.value)
    forced = arm.take(forced=True)
    assert forced.misfit[4] == pytest.approx(20.0, abs=1.0)


def test_tares_are_undone_one_by_one(law):
    arm = calibrated(law).fill(STRAIGHT)
    untared = arm.state.calibration
    first = arm.take()
    once_tared = arm.state.calibration
    arm.fill(BENT).take()
    assert arm.state.undoable == 2
    arm.undo()
    assert arm.state.tares == (first,)
    assert arm.state.calibration == once_tared
    arm.undo()
    assert not arm.state.known
    assert arm.state.calibration == untared
    with pytest.raises(TareError, match="nothing to undo"):
        arm.undo()
    line = tare_undone_line(first, None, FeltArm(ARM), 0)
    assert line.endswith("there is none now")
    line = tare_undone_line(first, first, FeltArm(ARM), 1, replaced=True)
    assert "it was the only one, so another took its place at " in line
    assert "cable_12 " in line


def test_a_tare_of_more_tendons_than_joints_is_described_by_the_joints(tmp_path):
    """What is observed of a machine whose joints are measured is the balance of each joint."""
    machine = machine_of_two_motors(tmp_path, 10.0, 20.0)
    felt = FeltModel(machine)
    law = MachineLaw(machine, TorchStater(machine))
    arm = Tared(CalibratedArm(felt, law, SETTINGS))
    arm.state = arm.arm.at(arm.state, felt.first_command)
    for _ in range(SETTINGS.tare_samples):
        arm.add(np.array([10.0, 10.0]))
    described = arm.take().described(felt)
    assert "left 10.00, right 10.00; joints' torques within " in described


def test_an_unsteady_channel_of_a_machine_is_named_with_its_unit():
    felt = FeltModel(example_machine("six_axis"))
    names = felt.channels.names
    law = MachineLaw(felt.source, TorchStater(felt.source))
    arm = CalibratedArm(felt, law, SETTINGS)
    state = arm.at(arm.begin(), felt.first_command)
    for k in range(SETTINGS.tare_samples):
        reading = np.zeros(len(names))
        reading[2] = 8.0 * (k % 2)
        state = with_reading(state, reading.tolist(), SETTINGS.tare_samples)
    with pytest.raises(TareError, match=rf"{names[2]} varies by 3\.92 N·m \("):
        arm.taken(state, NOW_NS)


def test_a_loaded_calibration_needs_no_tare_and_can_be_replaced(law):
    tared = calibrated(law).fill(STRAIGHT)
    tared.take()
    known = calibrated(law, tared.state.calibration)
    assert known.state.known
    assert not known.state.automatic
    replaced = known.arm.loaded(known.state, tared.state.calibration)
    assert replaced.undoable == 1


def test_cables_that_have_moved_since_the_untouched_arm_carry_friction(law):
    arm = calibrated(law).fill(STRAIGHT)
    arm.take()
    arm.fill(BENT, count=0)
    carried = arm.arm.calibrator.parameters.slices["carried_friction_0"]
    coefficient = arm.state.calibration.mean[-1]
    reading = tensions(BENT)
    for _ in range(5):
        arm.state = arm.arm.with_untouched(arm.state, reading)
    pulled = arm.belief(reading + np.eye(12)[2] * 4.0 - np.eye(12)[7] * 4.0)
    np.testing.assert_allclose(pulled.mean[carried][[2, 7]], [coefficient, -coefficient])
    freed = arm.belief(reading, freed=True)
    assert np.abs(freed.mean[carried]).max() == 0.0
    moved = arm.arm.calibrator.moved(arm.state.calibration)
    unknown = np.diagonal(moved.covariance[carried, carried])
    assert (np.diagonal(freed.covariance[carried, carried]) < 0.01 * unknown).all()


def test_the_sensors_zeros_drift_with_the_time_since_the_last_tare(law):
    arm = calibrated(law).fill(STRAIGHT)
    arm.take()
    zeros = arm.arm.calibrator.parameters.slices["sensor_zero"]
    now = np.diagonal(arm.belief(tensions(STRAIGHT)).covariance)[zeros]
    hour_later = NOW_NS + 3_600_000_000_000
    later = np.diagonal(arm.belief(tensions(STRAIGHT), hour_later).covariance)[zeros]
    np.testing.assert_allclose(later - now, ARM.tolerances.drift_n_per_hour**2, rtol=1e-6)


def test_the_same_state_gives_the_same_belief_whatever_was_asked_before(law):
    """A state is a value: what one branch of it learns, another does not know."""
    arm = calibrated(law).fill(STRAIGHT)
    arm.take()
    reading = tensions(STRAIGHT)
    for _ in range(5):
        arm.state = arm.arm.with_untouched(arm.state, reading)
    before = arm.state
    first = arm.belief(reading)
    arm.state = before
    arm.belief(reading + 4.0)
    arm.state = before
    again = arm.belief(reading)
    np.testing.assert_array_equal(first.mean, again.mean)
    np.testing.assert_array_equal(first.covariance, again.covariance)


def test_a_network_gets_the_tare_carried_to_the_pose_by_the_arm_file():
    offsets_n = np.linspace(-1.0, 1.0, 12)
    tared = TaredArm(ARM, SETTINGS.model_copy(update={"tare_deviation_n": 2.0}))
    arm = Tared(tared).fill(STRAIGHT, offsets_n)
    arm.take()
    arm.fill(BENT, count=0)
    arm.state = tared.predicted(arm.state)
    carried_n = tared.unloaded_n(arm.state)
    np.testing.assert_allclose(carried_n, tensions(BENT) + offsets_n, atol=1e-6)
    arm.fill(BENT, 5.0 * np.ones(12))
    with pytest.raises(TareError, match=r"cable_\d+ lies \+5\.0 N"):
        arm.take()
