"""The command that a verdict prints is the right one: it is run, and the error falls."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cablesense_contact.calibration_file import read_calibration
from cablesense_contact.felt_arm import FeltArm
from cablesense_gap import adaptation
from cablesense_gap.amended_arm import AMENDED_ARM, write_arm
from cablesense_gap.arm_system import Diagnosis
from cablesense_gap.recorded_contacts import recorded_errors
from cablesense_gap.report.next_step import Given, next_step, robot_next_step
from cablesense_gap.verdict import EstimatorErrors, Share, Verdict
from cablesense_recording.csv_file import write_csv
from cablesense_recording.recording import Recording
from cablesense_sim.arm import Arm, ListedEffect
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.replay import read_tensions_n, replay_arm
from cablesense_training.law.build import TorchLaw
from tests.helpers.expected_parameters import expected_parameters
from tests.helpers.gap_recordings import LAB, small_recording
from tests.helpers.html_page import draw_no_pictures
from tests.helpers.verdict_cases import verdict_of

PROTOCOL = small_recording(peak_n=25.0).rows(np.r_[0:164])
SHARE = Share(share_n=1.0, ci95_n=(0.9, 1.1), left_n=0.1, probability=1.0)
GIVEN = Given("new.csv", "arm.yaml", "found")

PRESENT = {
    "actuator_backlash": ("cable_12", {"play_m": 1e-3, "start": 1.0}),
    "base_tilt": ("arm", {"roll_rad": 0.15, "pitch_rad": 0.15}),
    "cable_creep": ("arm", {"share": 0.3, "time_s": 20.0, "begun": 0.5}),
    "cable_stiffness": ("arm", {"change": 0.6}),
    "capstan_friction": ("arm", {"coefficient": 0.15}),
    "contact_offset": ("arm", {"offset_m": 0.03}),
    "joint_elasticity": ("arm", {"stiffness_n_m_rad": 15.0}),
    "joint_friction": ("joint_4", {"torque_n_m": 0.3, "start_pitch": 0.5, "start_yaw": 0.5}),
    "load_cell": ("arm", {"scale": 0.3}),
    "payload": ("segment_4", {"mass_kg": 0.9}),
    "pretension_error": ("arm", {"error_n": 15.0}),
    "routing_geometry": ("segment_4", {"cables_radius_m": 0.03, "cables_angle_rad": 0.4}),
    "sensor_crosstalk": ("arm", {"share": 0.09}),
    "sensor_drift": ("cable_12", {f"rise_{k}_n": 2.0 for k in range(1, 11)}),
    "sensor_gain": ("cable_12", {"gain": 0.15}),
    "sensor_lag": ("arm", {"time_constant_s": 0.1}),
    "sensor_offset": ("cable_12", {"offset_n": 6.0}),
}
"""Every listed effect with a size that a recording shows."""
ESTIMATOR_IS_RIGHT = ("load_cell", "sensor_lag")
"""Effects that leave readings at rest as they are."""


def effect_of(name: str) -> ListedEffect:
    place, values = PRESENT[name]
    return ListedEffect(effect=name, at=place, parameters=values)


def recorded(arm: Arm) -> Recording:
    tensions_n = replay_arm(arm, PROTOCOL.course)
    readings_n = read_tensions_n(tensions_n, LAB.sensors, np.random.default_rng(0))
    return replace(PROTOCOL, tensions_n=readings_n)


def test_every_listed_effect_is_tried():
    assert set(PRESENT) == {name for name, each in known_effects().items() if not each.tolerance}


@pytest.fixture
def named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Files of an arm that has an effect, and diagnoses that name it without taking their time."""

    def put(name: str) -> Verdict:
        amended = LAB.model_copy(update={"effects": [effect_of(name)]})
        verdict = verdict_of(
            name,
            0.97,
            shares={name: SHARE},
            tolerances_n=0.1,
            unexplained_n=0.0,
            unexplained_share=0.0,
        )

        def diagnose(recording, arm, *_, force=False, announce=None, kept=None) -> Diagnosis:
            read_n = recording.tensions_n
            every = np.ones(len(recording), dtype=bool)
            known = expected_parameters(amended)
            return Diagnosis(recording, arm, verdict, amended, read_n, read_n, every, known)

        monkeypatch.setattr(adaptation, "diagnose", diagnose)
        write_csv(tmp_path / "new.csv", recorded(amended))
        write_arm(tmp_path / "arm.yaml", LAB, "")
        (tmp_path / "found").mkdir()
        write_arm(tmp_path / "found" / AMENDED_ARM, amended, "")
        return verdict

    draw_no_pictures(monkeypatch)
    monkeypatch.setattr(adaptation, "export_law", lambda _, path, *__: path.write_text("a model"))
    return put


def run(command, text: str, *more: str):
    program, *words = shlex.split(text)
    assert program == "cablesense"
    done = command(*words, *more)
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in PRESENT if name not in ESTIMATOR_IS_RIGHT])
def test_after_an_effect_the_estimator_is_adapted_and_its_error_falls(command, named, name):
    step = next_step(named(name), GIVEN)
    said = json.loads(run(command, step.command, "--json").stdout)
    errors = said["verdict"]["estimator"]
    assert said["better"]
    assert errors["after"]["wrong_force_n"] < 0.95 * errors["before"]["wrong_force_n"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ESTIMATOR_IS_RIGHT)
def test_after_a_wrong_load_cell_or_a_lag_the_recording_is_predicted_as_found(
    command, named, name
):
    step = next_step(named(name), GIVEN)
    found = json.loads(run(command, step.command, "--json").stdout)
    nominal = json.loads(
        run(command, "cablesense gap predict new.csv --arm arm.yaml --out n.csv --json").stdout
    )
    assert found["gap_n"] < 0.2
    assert found["gap_n"] < 0.5 * nominal["gap_n"]


@pytest.mark.slow
def test_after_none_the_arm_is_calibrated(command, named, tmp_path):
    named("load_cell")
    write_csv(tmp_path / "new.csv", recorded(LAB))
    run(command, next_step(verdict_of("none", 0.97), GIVEN).command)
    calibration = read_calibration(tmp_path / "found" / "calibration.npz", FeltArm(LAB))
    by_tolerances = np.sqrt(np.diag(calibration.prior_covariance))
    assert (calibration.std <= by_tolerances + 1e-12).all()
    errors = recorded_errors(recorded(LAB), TorchLaw(LAB), calibration=calibration)
    assert errors.wrong_n < 0.3


def test_after_unknown_or_undecided_verdicts_the_next_recording_is_made():
    for verdict in (
        verdict_of("unknown", 0.8),
        verdict_of("payload", 0.4),
        verdict_of("payload", 0.9, ambiguity_group=("payload", "base_tilt")),
    ):
        step = next_step(verdict, GIVEN)
        assert step.command == "cablesense gap record --arm arm.yaml --out next.mcap"


def test_after_an_adaptation_the_better_estimator_is_run():
    before = {"wrong_force_n": 3.98, "contact_accuracy": 0.99}
    after = {"wrong_force_n": 0.94, "contact_accuracy": 0.96}
    for use, words in (("after", "model:=found/estimator.onnx"), ("before", "arm:=arm.yaml")):
        errors = EstimatorErrors(before=before, after=after, use=use)
        step = next_step(verdict_of("payload", 0.97, estimator=errors), GIVEN)
        assert step.command.startswith("ros2 run cablesense_ros estimator --ros-args -p arm:=")
        assert words in step.command
        assert "3.98 N before, 0.94 N after" in step.why


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        (verdict_of("none", 0.97), "cablesense gap diagnose NEW_RECORDING --reference new.csv"),
        (verdict_of("unknown", 0.97), "cablesense gap protocol --model arm.yaml"),
        (verdict_of("joint_gain", 0.4), "cablesense gap protocol --model arm.yaml"),
        (verdict_of("joint_gain", 0.97), "cablesense gap predict NEW_RECORDING --model found"),
    ],
)
def test_robots_have_a_next_step_too(verdict, words):
    assert robot_next_step(verdict, GIVEN).command.startswith(words)
