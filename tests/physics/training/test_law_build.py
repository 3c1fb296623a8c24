"""The estimator of an arm knows what its file lists: sensors, joint zeros, and more noise."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from cablesense_sim.arm import Arm, ListedEffect, open_arm
from cablesense_sim.course import Course
from cablesense_sim.replay import reading_variance_n2, replay_arm
from cablesense_sim.uncertain_arm import arm_parameters
from cablesense_training.law.build import TorchLaw

NOMINAL = open_arm("cdsm_lab")
COMMANDS = np.deg2rad([[0.0] * 8, [5.0, -3.0, 4.0, 2.0, -6.0, 1.0, 3.0, -2.0]])
LISTED = (
    ListedEffect(effect="sensor_gain", at="cable_2", parameters={"gain": -0.4}),
    ListedEffect(effect="sensor_offset", at="cable_7", parameters={"offset_n": 6.0}),
    ListedEffect(effect="sensor_crosstalk", at="arm", parameters={"share": 0.05}),
    ListedEffect(effect="sensor_lag", at="arm", parameters={"time_constant_s": 1.0}),
    ListedEffect(
        effect="sensor_tolerance", at="cable_3", parameters={"gain": 0.02, "zero_n": -1.0}
    ),
    ListedEffect(effect="joint_tolerance", at="joint_2", parameters={"pitch_rad": 0.01}),
    ListedEffect(effect="cable_tolerance", at="cable_5", parameters={"pretension_n": 3.0}),
    ListedEffect(effect="payload", at="segment_3", parameters={"mass_kg": 0.5}),
)


def innovation_n(law: TorchLaw, readings_n: np.ndarray) -> np.ndarray:
    """Of readings at rest, without the friction that may be expected of any arm."""
    parameters = arm_parameters(law.arm)
    mean = np.zeros(len(parameters))
    covariance = np.diag(parameters.prior_std**2)
    return law(readings_n, COMMANDS, mean, covariance, np.zeros((8, 8))).innovation_n


def settled_n(arm: Arm) -> np.ndarray:
    """(2, M) without noise, each long after the command."""
    forces_n = np.zeros((1, 4, 3))
    read = [replay_arm(arm, Course(np.zeros(1), command[None], forces_n)) for command in COMMANDS]
    return np.concatenate(read)


def test_the_unloaded_arm_reads_what_its_file_lists():
    arm = NOMINAL.model_copy(update={"effects": list(LISTED)})
    readings_n = settled_n(arm)
    assert np.abs(innovation_n(TorchLaw(NOMINAL), readings_n)).max() > 5.0
    assert_allclose(innovation_n(TorchLaw(arm), readings_n), 0.0, atol=2e-3)


def test_what_is_unexplained_adds_to_the_noise_of_readings():
    parameters = arm_parameters(NOMINAL)
    nothing = np.zeros((len(parameters), len(parameters)))
    given = settled_n(NOMINAL), COMMANDS, np.zeros(len(parameters)), nothing, np.zeros((8, 8))
    variance_n2 = reading_variance_n2(NOMINAL.sensors)
    of_one_direction = 0.25 * np.outer(np.arange(12.0), np.arange(12.0))
    for unexplained_n2 in (np.zeros((12, 12)), of_one_direction):
        information_n2 = TorchLaw(NOMINAL, unexplained_n2)(*given).information_n2
        expected = np.linalg.inv(variance_n2 * np.eye(12) + unexplained_n2)
        assert_allclose(information_n2, np.stack([expected, expected]), rtol=1e-5, atol=1e-6)
