"""A law is compared with the statics of its arm before it becomes a model file."""

from dataclasses import replace

import numpy as np
import pytest

from cablesense_sim.arm import Arm, parse_arm
from cablesense_sim.load_capacity import WeakArmError
from cablesense_training.errors import TrainingError
from cablesense_training.evaluation.law import evaluate_exact, law_protocol
from cablesense_training.evaluation.touches import drawn_touches, settled_readings_n
from cablesense_training.law.build import TorchLaw
from cablesense_training.law_check import MOST_OVER_BOUND, LawCheck, check_law, require_sound
from cablesense_training.law_export import export_law
from tests.helpers.arm_variants import SOFT_CABLES, variant


def soft_arm(spring_n_m_rad: float) -> Arm:
    """Two segments with four cables of 3 kN/m each, and a spring in the first joint."""
    return variant({**SOFT_CABLES, "effects": [spring("joint_1", spring_n_m_rad)]}, "cdsm_lab")


def spring(joint: str, stiffness_n_m_rad: float) -> dict:
    parameters = {"stiffness_n_m_rad": stiffness_n_m_rad}
    return {"effect": "joint_elasticity", "at": joint, "parameters": parameters}


@pytest.mark.parametrize("spring_n_m_rad", [8.3, 20.0, 200.0])
def test_soft_arms_with_a_spring_have_a_law_that_holds(spring_n_m_rad):
    arm = soft_arm(spring_n_m_rad)
    law = TorchLaw(arm)
    assert require_sound(law, arm).worst < MOST_OVER_BOUND
    stated = evaluate_exact(law, arm, law_protocol(arm, 300), seed=3)
    assert stated.false_contacts == 0
    assert stated.touched.moment_n_m.median_over_bound < MOST_OVER_BOUND


def test_a_law_without_the_spring_of_its_arm_is_refused():
    arm = soft_arm(8.3)
    rigid = TorchLaw(arm.nominal)
    check = check_law(rigid, arm)
    assert check.misfit > MOST_OVER_BOUND
    with pytest.raises(TrainingError, match=r"does not hold on the arm's own statics.* times the"):
        require_sound(rigid, arm)


def test_figures_that_nothing_states_are_not_judged_but_one_of_them_must_be():
    nan = float("nan")
    whole = LawCheck(
        samples=500,
        misfit=1.0,
        moment=1.0,
        place=nan,
        force=nan,
        answered=0.9,
        false_contacts=0.0,
        slack=0.0,
        pose_range_deg=20.0,
        force_range_n=50.0,
    )
    assert whole.fault == ""
    assert whole.worst == 1.0
    assert "none of its errors can be judged" in replace(whole, moment=nan).fault
    assert "errors of the place are 2 times" in replace(whole, place=2.0).fault


THIN_WITH_SLACK_CABLES = """
name: thin
gravity_m_s2: [0, 0, -9.81]
segments: {count: 4, length_m: 0.178, mass_kg: 0.031, plate_offset_m: 0.0313, contact_m: 0.089}
cables:
  per_segment: 3
  routing_radius_m: 0.0158
  angle_deg: {first: 0, per_segment: 30, per_cable: -120}
  stiffness_n_m: 5.47e4
  pretension_n: 82
  run_m: 0.2
actuators: {kind: position, kp_n_m: .inf}
sensors: {place: actuator end, rate_hz: 100, noise_std_n: 0.0117, step_n: 0.05}
"""


@pytest.mark.slow
def test_an_arm_whose_cables_go_slack_is_refused_and_leaves_no_file(tmp_path):
    arm = parse_arm(THIN_WITH_SLACK_CABLES)
    path = tmp_path / "thin.onnx"
    with pytest.raises(TrainingError, match=r"a cable is slack in 100% .*raise cables.pretension"):
        export_law(arm, path, "cablesense export")
    assert not path.exists()


@pytest.mark.slow
def test_where_readings_stay_unexplained_that_is_said_and_no_other_arm_is_asked_for(tmp_path):
    arm = variant({}, "cdsm_lab")
    with pytest.raises(TrainingError, match=r"off by 1e\+03 N \(RMS\): first find") as refusal:
        export_law(arm, tmp_path / "unexplained.onnx", "cablesense gap adapt", 1e6 * np.eye(12))
    assert "pretension" not in str(refusal.value)


def test_an_arm_that_cannot_stand_is_refused(tmp_path):
    arm = variant({"segments.mass_kg": 50.0}, "cdsm_lab")
    with pytest.raises(WeakArmError, match="cannot stand"):
        export_law(arm, tmp_path / "heavy.onnx", "cablesense export")


def test_effects_with_a_memory_are_left_out_of_the_statics():
    friction = {"effect": "capstan_friction", "at": "arm", "parameters": {"coefficient": 0.15}}
    lag = {"effect": "sensor_lag", "at": "arm", "parameters": {"time_constant_s": 0.2}}
    plain = variant({}, "cdsm_lab")
    remembering = variant({"effects": [friction, lag]}, "cdsm_lab")
    touches = drawn_touches(plain, law_protocol(plain, 20), seed=1)
    read = [
        settled_readings_n(arm, touches, np.random.default_rng(1)) for arm in (plain, remembering)
    ]
    np.testing.assert_array_equal(*read)


def test_listed_joint_zeros_and_sensors_are_in_the_statics():
    zeros = {"effect": "joint_tolerance", "at": "joint_2", "parameters": {"pitch_rad": 0.02}}
    gain = {"effect": "sensor_gain", "at": "cable_3", "parameters": {"gain": 0.2}}
    arm = variant({"effects": [zeros, gain]}, "cdsm_lab")
    require_sound(TorchLaw(arm), arm)
