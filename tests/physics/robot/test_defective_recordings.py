"""Recordings with a defect that does no harm: the verdict is that of a whole one."""

import pandas as pd
import pytest
from typer.testing import CliRunner

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import diagnose
from cablesense_gap.verdict import read_verdict
from cablesense_ros.cli.app import app
from tests.helpers.bags import write_joint_states
from tests.helpers.html_page import show_no_film
from tests.helpers.two_link import JOINTS, XML, recorded, write_model

pytestmark = pytest.mark.slow

FRICTION_N_M = (0.0, 0.2)


@pytest.fixture
def table(tmp_path):
    return pd.read_csv(recorded(tmp_path / "whole.csv", friction=FRICTION_N_M))


def leapt(table, seconds):
    """The clock is set in the middle of the third trial."""
    late = table.index >= table.index[table.trial == 2][200]
    return table.assign(time_s=table.time_s + seconds * late)


@pytest.mark.parametrize("seconds", [0.3, 1.7e9])
def test_a_leap_of_time_does_not_change_the_verdict(tmp_path, table, seconds):
    robot = load_robot(write_model(tmp_path))
    leapt(table, seconds).to_csv(tmp_path / "leapt.csv", index=False)
    diagnosis = diagnose(read_robot_recording(tmp_path / "leapt.csv", robot), robot)
    assert diagnosis.verdict.effects == ("joint_friction",)
    assert diagnosis.verdict.where.joints == ("elbow",)
    assert any("the trial is parted there" in note for note in diagnosis.notes)


def test_the_chosen_topic_and_joints_with_colons_give_the_verdict(tmp_path, table, monkeypatch):
    show_no_film(monkeypatch)
    model = tmp_path / "model.xml"
    named = XML
    for joint in JOINTS:
        named = named.replace(f'joint name="{joint}"', f'joint name="arm:{joint} 1"')
        named = named.replace(f'joint="{joint}"', f'joint="arm:{joint} 1"')
    model.write_text(named)
    bag = tmp_path / "bag"
    bag.mkdir()
    names = {joint: f"arm:{joint} 1" for joint in JOINTS}
    healthy = pd.read_csv(recorded(tmp_path / "healthy.csv"))
    write_joint_states(bag / "bag_0.mcap", healthy, "/left/joint_states", names)
    write_joint_states(bag / "bag_1.mcap", table, "/right/joint_states", names)
    arguments = ["gap", "diagnose", bag, "--model", model, "--out", tmp_path / "out"]
    refused = CliRunner().invoke(app, list(map(str, arguments)))
    assert "/left/joint_states" in str(refused.exception)
    arguments += ["--topic", "/right/joint_states", "--workers", "1"]
    done = CliRunner().invoke(app, list(map(str, arguments)))
    assert done.exit_code == 0, done.exception
    assert "Joint states are those of /right/joint_states." in done.output
    assert "/right/joint_states" in (tmp_path / "out" / "report.html").read_text()
    verdict = read_verdict(tmp_path / "out" / "verdict.json")
    assert verdict.effects == ("joint_friction",)
    assert verdict.where.joints == ("arm_elbow_1",)
