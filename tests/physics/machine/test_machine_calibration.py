"""Calibrations of a machine that MuJoCo describes: planted deviations come back."""

import numpy as np
import pytest

from cablesense_contact.calibration import CalibrationError, Calibrator, Unloaded
from cablesense_contact.calibration_file import (
    CalibratedMachine,
    calibration_bytes,
    calibration_of,
    described,
)
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_contact.machine.law import MachineLaw
from cablesense_sim.machine.simulated import SimulatedMachine
from tests.helpers.example_machines import bent_command, example_machine
from tests.helpers.torch_stater import TorchStater

POSES = 6
READINGS = 20
BUILT = 10


@pytest.fixture(scope="module")
def finger():
    """The finger and its calibrator."""
    machine = example_machine("finger")
    felt = FeltModel(machine)
    return felt, Calibrator(felt, MachineLaw(machine, TorchStater(machine)))


def unloaded(felt, theta, seed):
    """Means of readings of a machine with these deviations, in some poses."""
    machine = felt.source
    built = SimulatedMachine(machine, felt.parameters, theta)
    rng = np.random.default_rng(seed)
    means = []
    for pose in range(POSES):
        command = bent_command(machine, 100 * seed + pose)
        values = np.tile(built.untouched(command).values, (READINGS, 1))
        reading = machine.channels.read(values, rng).mean(axis=0)
        means.append(Unloaded(reading, command, READINGS))
    return means


def test_planted_deviations_are_within_their_intervals_and_gains_are_found(finger):
    felt, calibrator = finger
    parameters = felt.parameters
    rng = np.random.default_rng(1)
    inside = []
    gain_errors = []
    for seed in range(BUILT):
        theta = parameters.drawn(rng)
        calibration = calibrator.from_poses(unloaded(felt, theta, seed))
        assert calibration.as_described
        known = calibration.std > 0.0
        off = np.abs(calibration.mean - theta)[known] / calibration.std[known]
        inside.append(off < 1.96)
        gains = parameters.slices["sensor_gain"]
        gain_errors.append((calibration.mean - theta)[gains])
    assert 0.93 < np.mean(inside) < 0.98
    # tendons balance over joints, which tells their gains from each other
    assert np.std(gain_errors) < 0.7 * parameters.prior_std[parameters.slices["sensor_gain"]][0]


def test_a_machine_beyond_its_tolerances_is_doubted(finger):
    felt, calibrator = finger
    theta = 8.0 * felt.parameters.drawn(np.random.default_rng(3))
    assert not calibrator.from_poses(unloaded(felt, theta, 50)[:3]).as_described


def test_a_file_says_whose_it_is_and_is_shown_without_the_machine(finger):
    felt, calibrator = finger
    theta = felt.parameters.drawn(np.random.default_rng(4))
    calibration = calibrator.from_poses(unloaded(felt, theta, 60))
    content = calibration_bytes(calibration, felt)
    whose = described(content, "file")
    assert isinstance(whose, CalibratedMachine)
    assert whose.identity == felt.identity
    assert whose.parameters.groups == felt.parameters.groups
    for machine in (whose, felt):
        again = calibration_of(content, machine, "file")
        np.testing.assert_array_equal(again.mean, calibration.mean)
    other = FeltModel(example_machine("six_axis"))
    with pytest.raises(CalibrationError, match="not of six_axis-"):
        calibration_of(content, other, "file")
