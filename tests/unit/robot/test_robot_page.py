"""The example of `docs/robot_method.md` runs, and says what the page says."""

import re

import numpy as np
import pandas as pd
import pytest

from cablesense_gap.report.film import FilmError
from cablesense_gap.report.page import robot_page
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import RobotDiagnosis, RobotSystem, write_prediction
from cablesense_gap.system import problem_of
from cablesense_gap.verdict import ChannelGap
from tests.helpers.checkout import CHECKOUT
from tests.helpers.two_link import recorded, write_model
from tests.helpers.verdict_cases import gap_of, verdict_of

PAGE = CHECKOUT / "docs" / "robot_method.md"


@pytest.fixture(autouse=True)
def _no_film(monkeypatch):
    """A film takes seconds, and has tests of its own."""

    def refuse(_diagnosis):
        raise FilmError("none is made here")

    monkeypatch.setattr("cablesense_gap.report.film.robot_film", refuse)


def test_the_simulator_of_the_page_finds_the_sticking_pointer(capsys):
    examples = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    example = next(e for e in examples if "class Balance" in e)
    exec(compile(example, str(PAGE), "exec"), {})
    assert capsys.readouterr().out.strip() == "('stuck',)"


@pytest.mark.parametrize(
    ("effects", "more", "says", "never"),
    [
        ("unknown", {}, "45.9 floors, with manufacturing tolerances 16.7 floors", "shrinks"),
        ("unknown", {}, "Keep the nominal model", "flexible correction"),
        ("joint_friction", {"doubts": ("It ends.",)}, "rely on the amended model yet", "Use the"),
        ("joint_friction", {}, "Use the amended model", "rely on the amended model yet"),
    ],
)
def test_the_report_says_what_to_do(tmp_path, effects, more, says, never):
    robot = load_robot(write_model(tmp_path))
    motion = prepared(
        read_robot_recording(recorded(tmp_path / "recording.csv", trials=6), robot), robot
    )
    system = RobotSystem(robot, motion, {})
    channels = {"elbow": ChannelGap(unit="N·m", before=1.0, after=0.1, floor=0.1)}
    gap = gap_of(45.9, 16.7, 1.0).model_copy(update={"effects_n": 17.0})
    named = verdict_of(effects, gap=gap, channels=channels, rows=9, **more)
    named = named.model_copy(update={"unit": "floors"})
    nothing = np.zeros_like(system.readings)
    note = "Trials by their column."
    diagnosis = RobotDiagnosis(system, named, {}, nothing, nothing, (note,), (), {})
    page = " ".join(robot_page(diagnosis, "folder").split())
    assert note in page
    assert "Check the recording first" not in page
    assert says in page
    assert never not in page


def test_the_report_warns_of_what_looks_wrong(tmp_path):
    robot = load_robot(write_model(tmp_path))
    table = pd.read_csv(recorded(tmp_path / "recording.csv", trials=6))
    table.assign(**{"torque.elbow": 0.37}).to_csv(tmp_path / "dead.csv", index=False)
    recording = read_robot_recording(tmp_path / "dead.csv", robot)
    (warning,) = recording.warnings
    system = RobotSystem(robot, prepared(recording, robot), {})
    verdict = verdict_of("none", gap=gap_of(1.2, 1.1, 1.0), rows=9)
    verdict = verdict.model_copy(update={"unit": "floors"})
    nothing = np.zeros_like(system.readings)
    made = RobotDiagnosis(
        system, verdict, {}, nothing, nothing, recording.notes, recording.warnings, {}
    )
    page = " ".join(robot_page(made, "folder").split())
    before, after = page.split("Check the recording first.")
    assert recording.notes[0] in before
    assert warning in after


def test_a_gap_that_nothing_explains_has_a_next_experiment(tmp_path):
    robot = load_robot(write_model(tmp_path))
    motion = prepared(
        read_robot_recording(recorded(tmp_path / "recording.csv", trials=6), robot), robot
    )
    system = RobotSystem(robot, motion, {})
    residual = np.where(system.trial[:, None] == 3, 9.0, 1.0) * np.ones_like(system.readings)
    said = system.unlisted(problem_of(system), residual).experiment
    assert said.startswith("Repeat trial 3, which has the largest residual (9 floors)")


@pytest.mark.parametrize("forward", [False, True])
def test_trials_are_called_as_the_file_calls_them(tmp_path, forward):
    robot = load_robot(write_model(tmp_path))
    table = pd.read_csv(recorded(tmp_path / "recording.csv", trials=6))
    numbers = np.array([70, 71, 72, 80, 81, 82])
    table["trial"] = numbers[table.trial]
    short = (table.trial == 71) & (table.groupby("trial").cumcount() >= 10)
    table[~short].to_csv(tmp_path / "numbered.csv", index=False)
    recording = read_robot_recording(tmp_path / "numbered.csv", robot)
    system = RobotSystem(robot, prepared(recording, robot, forward=forward), {})
    residual = np.where(system.trial[:, None] == 2, 9.0, 1.0) * np.ones_like(system.readings)
    # the second trial is too short to be compared
    assert system.trial_labels([0, 1, 2, 4]) == (70, 72, 80, 82)
    again = system.unlisted(problem_of(system), residual).experiment
    assert again.startswith("Repeat trial 80, which")
    write_prediction(tmp_path / "predicted.csv", system)
    predicted = pd.read_csv(tmp_path / "predicted.csv")
    assert set(predicted.trial) == {70, 72, 80, 81, 82}
