"""What a healthy recording does not cover is not judged; a load that it bore may be taken off."""

import numpy as np
import pytest

from cablesense_gap.report.text import coverage_sentence, headline
from cablesense_gap.robot.amending import changed
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import diagnose
from cablesense_gap.simulator import Term
from tests.helpers.two_link import worn, write_model

ELSEWHERE_RAD = 3.0


@pytest.fixture
def since(tmp_path):
    """The diagnosis of a pendulum against its healthy recording, both as planted."""
    robot = load_robot(write_model(tmp_path))

    def diagnosed(healthy, later):
        paths = (
            worn(tmp_path / "healthy.csv", 1, **healthy),
            worn(tmp_path / "later.csv", 3, **later),
        )
        reference, recording = (read_robot_recording(path, robot) for path in paths)
        return diagnose(recording, robot, reference=reference)

    return diagnosed


@pytest.mark.slow
@pytest.mark.parametrize("friction_n_m", [0.0, 0.3])
def test_a_joint_that_moves_where_it_never_was_is_not_called_healthy(since, friction_n_m):
    planted = {"home": (ELSEWHERE_RAD, 0.0), "friction": (friction_n_m, 0.0)}
    verdict = since({}, planted).verdict
    assert verdict.effects == ("cannot_tell",)
    coverage = verdict.reference.coverage
    assert coverage["shoulder"].share < 0.1
    # the arm is turned over, so the elbow bears its weight the other way
    assert {each.quantity for each in coverage["elbow"].lacking} == {"load"}
    lacking = {each.quantity: each for each in coverage["shoulder"].lacking}
    low_rad, high_rad = lacking["position"].recorded
    assert low_rad < ELSEWHERE_RAD < high_rad
    assert lacking["position"].reference[1] < low_rad + 0.5
    assert "shoulder at positions of" in verdict.next_experiment
    assert headline(verdict).startswith("Cannot tell whether anything changed")
    assert "of shoulder and" in headline(verdict)
    assert headline(verdict).endswith(": record this motion when healthy.")


@pytest.mark.slow
def test_the_same_motion_is_covered(since):
    verdict = since({}, {}).verdict
    assert verdict.effects == ("none",)
    assert verdict.reference.covered_share > 0.8
    assert "% of the readings" in coverage_sentence(verdict)


@pytest.mark.slow
def test_a_load_that_was_taken_off_is_stated_in_kilograms_and_metres(since):
    """It hung at the end of the lower link, 0.1 m from the link's centre of mass."""
    diagnosis = since({"payload": 0.5}, {})
    verdict = diagnosis.verdict
    assert verdict.effects == ("payload",)
    assert verdict.where.bodies == ("lower",)
    mass = verdict.parameters["payload.mass_kg"]
    assert mass.value == pytest.approx(-0.5, rel=0.1)
    assert verdict.parameters["payload.place_x_m"].value == pytest.approx(0.1, abs=0.03)
    assert "kg taken off at lower, 0." in headline(verdict)
    robot = diagnosis.system.robot
    amended_kg = changed(robot, [diagnosis.amended]).mass_kg
    assert amended_kg == pytest.approx(robot.nominal().mass_kg, rel=0.1)


def test_a_listed_load_and_a_change_of_it_are_one_mass(tmp_path):
    robot = load_robot(write_model(tmp_path))
    borne = {
        Term("payload", "lower", "mass_kg"): 2.0,
        Term("payload", "lower", "moment_x_kg_m"): 0.2,
    }
    less = {term: -0.5 * value for term, value in borne.items()}
    half = {term: 0.5 * value for term, value in borne.items()}
    off = {term: -value for term, value in borne.items()}
    assert np.allclose(
        changed(robot, [borne, less]).inertial_parameters(),
        changed(robot, [half]).inertial_parameters(),
    )
    assert np.allclose(
        changed(robot, [borne, off]).inertial_parameters(), robot.nominal().inertial_parameters()
    )
