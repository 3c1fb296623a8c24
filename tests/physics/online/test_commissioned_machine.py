"""The commissioning of a machine that MuJoCo describes: by joints, and by actuators; no ROS."""

import shutil

import numpy as np
import pytest

from cablesense_contact.calibration import Calibrator
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_contact.machine.law import MachineLaw
from cablesense_online.chosen_poses import chosen_poses
from cablesense_online.commissioning import Commissioning, CommissioningSettings, Stage
from cablesense_online.machine_models import LoadedMachine
from cablesense_online.movable import taut
from cablesense_online.movable_machine import MovableMachine
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.machine import open_machine
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce
from tests.helpers.example_machines import MACHINES, bent_command, example_machine
from tests.helpers.torch_stater import TorchStater

NS = 1_000_000_000
STEP_S = 0.2
POSES = 6
REACH_RAD = float(np.deg2rad(8.0))


@pytest.fixture(scope="module", params=["commanded", "actuators"])
def finger(request, tmp_path_factory):
    """The finger, whose joints or actuators are commanded, its law, and its chosen poses."""
    folder = tmp_path_factory.mktemp("finger")
    shutil.copy(MACHINES / "finger.xml", folder)
    text = (MACHINES / "finger.yaml").read_text()
    path = folder / "finger.yaml"
    path.write_text(text.replace("joints: commanded", f"joints: {request.param}"))
    machine = open_machine(path)
    movable = MovableMachine(FeltModel(machine))
    law = MachineLaw(machine, TorchStater(machine))
    return movable, law, chosen_poses(movable, law, POSES, REACH_RAD)


class Bench:
    """Plays a commissioning against a built machine, sample by sample."""

    def __init__(self, finger, theta):
        movable, law, poses = finger
        machine = movable.felt.source
        self.start = movable.felt.first_command
        settings = CommissioningSettings(readings=10, silent_after_s=2.0)
        rate_hz = 1.0 / STEP_S
        self.run_by = Commissioning(movable, law, poses, self.start, 0, rate_hz, settings)
        self.built = SimulatedMachine(machine, movable.felt.parameters, theta)
        self.pushed = ()
        self.command = self.start
        self._machine = machine
        self._now_ns = 0
        self._rng = np.random.default_rng(0)

    def run(self, until):
        """Go on until something is true."""
        while not until(self.run_by):
            self._now_ns += round(STEP_S * NS)
            assert self._now_ns < 500 * NS
            sent = self.run_by.advance(self._now_ns)
            self.command = self.command if sent is None else sent
            values = self.built.under(self.command, self.pushed, None).values
            self.run_by.take(self._machine.channels.read(values, self._rng), self._now_ns)


def theta_of(movable, seed):
    return movable.felt.parameters.drawn(np.random.default_rng(seed))


def test_chosen_poses_are_within_reach_and_taut(finger):
    movable, law, commands = finger
    assert len(np.unique(commands, axis=0)) == POSES
    prior = Calibrator(movable.felt, law).by_tolerances()
    assert taut(movable, commands, prior).all()
    away = np.abs(commands - movable.felt.first_command).max()
    assert 0.5 * REACH_RAD * movable.per_radian < away < 3.0 * REACH_RAD * movable.per_radian
    # every tendon is drawn on the way to a pose, and none by more than its lever allows
    beside = movable.beside(0.02)
    assert 0.0 < np.abs(beside).max() < 0.02 * 3.0 * movable.per_radian
    # a fingertip 80 mm from its first joint
    assert 0.001 < movable.farthest_m(movable.felt.first_command, commands) < 0.04


def test_a_built_machine_is_known_after_its_commissioning(finger):
    movable, law, _ = finger
    theta = theta_of(movable, 5)
    bench = Bench(finger, theta)
    before = bench.run_by.progress
    assert before.holds == POSES
    bench.run(lambda run: run.over)
    done = bench.run_by
    assert done.stage is Stage.DONE, done.problem
    assert done.calibration.as_described
    assert len(done.calibration.unloaded) == POSES
    np.testing.assert_array_equal(bench.command, bench.start)
    after = done.progress.known_force
    assert after.half_interval_n < 0.5 * before.known_force.half_interval_n
    # readings in other poses are now predicted
    elsewhere = np.array([bent_command(movable.felt.source, seed, 7.0) for seed in range(6)])
    true_n = np.array([bench.built.untouched(command).values for command in elsewhere])
    prior = Calibrator(movable.felt, law).by_tolerances()
    off_before = np.abs(movable.predicted_n(elsewhere, prior) - true_n)
    off_after = np.abs(movable.predicted_n(elsewhere, done.calibration) - true_n)
    assert off_after.mean() < 0.2 * off_before.mean()


def test_a_contact_stops_it(finger):
    movable, _, _ = finger
    bench = Bench(finger, theta_of(movable, 6))
    bench.run(lambda run: run.progress.holds_done == 4 and run.stage is Stage.HOLDING)
    bench.pushed = (LinkForce(1, np.array([0.015, 0.0, 0.0]), np.array([0.0, 0.0, 1.5])),)
    bench.run(lambda run: run.over)
    assert bench.run_by.stage is Stage.STOPPED
    assert "touch" in bench.run_by.problem
    assert len(bench.run_by.calibration.unloaded) == 4


def test_joints_stay_within_their_ranges():
    machine = example_machine("finger")
    movable = MovableMachine(FeltModel(machine))
    commands = movable.candidates(40, 1.0, np.random.default_rng(0))
    low, high = machine.model.jnt_range[machine.coordinates.joints].T
    assert (commands > low).all()
    assert (commands < high).all()


def test_a_machine_of_measured_joints_is_not_moved():
    measured = example_machine("six_axis")
    loaded = LoadedMachine(measured, MachineLaw(measured, TorchStater(measured)), "six_axis.onnx")
    assert not loaded.is_movable
    with pytest.raises(MachineError, match="cablesense calibrate"):
        loaded.movable()


def test_a_machine_of_commanded_joints_is_moved(finger):
    _, law, _ = finger
    assert LoadedMachine(law.machine, law, "finger.onnx").is_movable
