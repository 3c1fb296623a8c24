"""A stranger's way: an MJCF and a CSV, two commands, and the truth that was planted."""

import json

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from cablesense_gap.report.text import earlier_sentence
from cablesense_gap.robot.amending import changed, load_amended, write_amended
from cablesense_gap.robot.doubts import starts_at_zero
from cablesense_gap.robot.inverse import InverseDynamics
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import RobotSystem, diagnose
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import read_verdict
from cablesense_ros.cli.app import app
from tests.helpers.html_page import show_no_film
from tests.helpers.two_link import model_torques, motion, recorded, torques, write_model


@pytest.fixture
def model(tmp_path):
    return write_model(tmp_path)


def found_in(tmp_path, model, **planted):
    path = recorded(tmp_path / "recording.csv", **planted)
    robot = load_robot(model)
    return diagnose(read_robot_recording(path, robot), robot).verdict


def test_the_closed_form_and_mujoco_agree():
    _, *moved = motion(np.random.default_rng(0))
    assert np.allclose(torques(*moved), model_torques(*moved), atol=1e-9)


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is(tmp_path, model):
    verdict = found_in(tmp_path, model, seed=3)
    assert verdict.effects == ("none",)
    assert verdict.gap.before_n < 1.5


@pytest.mark.slow
def test_from_nothing_to_a_report_in_two_commands(tmp_path, model, monkeypatch):
    show_no_film(monkeypatch)
    first = recorded(tmp_path / "first.csv.gz", friction=(0.1, 0.08))
    second = recorded(tmp_path / "second.csv", seed=7, friction=(0.1, 0.08))
    out = tmp_path / "diagnosis"
    runner = CliRunner()
    diagnosed = ["diagnose", first, "--model", model, "--out", out, "--workers", 1]
    ran = runner.invoke(app, ["gap", *map(str, diagnosed)])
    assert ran.exit_code == 0, ran.output
    assert "dry friction at" in ran.output
    asked = ["predict", second, "--model", out, "--out", tmp_path / "p.csv", "--json"]
    ran = runner.invoke(app, ["gap", *map(str, asked)])
    assert ran.exit_code == 0, ran.output
    assert max(json.loads(ran.output)["gap"].values()) < 0.02  # of 0.1 N·m that were planted
    assert read_verdict(out / "verdict.json").effects == ("joint_friction",)
    assert "dry friction" in (out / "report.html").read_text()
    robot, beside = load_amended(out)
    assert robot.model.dof_frictionloss == pytest.approx([0.1, 0.08], abs=0.005)
    tolerances = {"drive_tolerance", "timing_tolerance"}
    assert {term.effect for term in beside} == {*tolerances, "joint_friction"}
    beside_friction = {t.parameter for t in beside if t.effect == "joint_friction"}
    assert beside_friction == {"presliding"}  # no MJCF has a word for it


def test_losses_count_by_the_drives_torque_or_by_the_joints(tmp_path, model):
    robot = load_robot(model)
    part = 0.2
    motion = prepared(read_robot_recording(recorded(tmp_path / "recording.csv"), robot), robot)
    dynamics = InverseDynamics(robot, motion)
    place = ("load_friction", "elbow")
    needed = dynamics.torques(robot.nominal())[:, 1]
    slides = np.abs(np.abs(motion.direction[:, 1]) - 1.0) < 1e-3
    way = np.sign(motion.direction[:, 1] * needed)[slides]
    for side, law in ((1.0, 1.0 / (1.0 - part * way)), (-1.0, 1.0 + part * way)):
        values = {Term(*place, "share"): np.arctanh(part), Term(*place, "side"): side}
        given = dynamics.torques(changed(robot, [values]))[:, 1]
        assert given[slides] == pytest.approx(law * needed[slides], rel=2e-3)


def test_torques_in_another_unit_are_told(tmp_path, model):
    path = recorded(tmp_path / "recording.csv", read=lambda torque: torque * [1.0, 1e3])
    robot = load_robot(model)
    system = RobotSystem(robot, prepared(read_robot_recording(path, robot), robot), {})
    doubts = system.doubtful()
    assert len(doubts) == 1
    assert doubts[0].startswith("torque.elbow is 1e+03 times")


def test_encoders_that_are_zeroed_where_trials_begin_give_each_its_own_zeros(tmp_path, model):
    path = recorded(tmp_path / "recording.csv", trials=3, friction=(0.1, 0.08))
    table = pd.read_csv(path)
    joints = ["position.shoulder", "position.elbow"]
    hung = 0.05 * np.random.default_rng(2).standard_normal((3, 2))
    table[joints] -= hung[table["trial"]]
    table.to_csv(path, index=False)
    robot = load_robot(model)
    zeros = {}
    sizes = zip(("shoulder", "elbow"), (0.1, 0.08), strict=True)
    friction = {Term("joint_friction", joint, "torque_n_m"): size for joint, size in sizes}
    for zeroed in (False, True):
        motion = prepared(read_robot_recording(path, robot), robot, zeroed=zeroed)
        gaps = RobotSystem(robot, motion, friction).gaps()
        zeros[zeroed] = max(gap for _, _, gap, _ in gaps)
    assert zeros[False] > 3.0 * zeros[True]
    assert zeros[True] < 0.012  # N·m


def test_trials_that_begin_at_zero_are_told(tmp_path, model):
    robot = load_robot(model)
    path = recorded(tmp_path / "recording.csv", trials=6)
    assert not starts_at_zero(read_robot_recording(path, robot))
    table = pd.read_csv(path)
    joints = ["position.shoulder", "position.elbow"]
    table[joints] -= table.groupby("trial")[joints].transform("first")
    table.to_csv(path, index=False)
    (said,) = starts_at_zero(read_robot_recording(path, robot))
    assert "--zeroed" in said


@pytest.mark.slow
def test_with_the_amended_model_nothing_is_left_to_find(tmp_path, model):
    path = recorded(
        tmp_path / "recording.csv", friction=(0.1, 0.0), read=lambda torque: torque * [1.0, 1.2]
    )
    robot = load_robot(model)
    first = diagnose(read_robot_recording(path, robot), robot)
    verdict = first.verdict
    assert verdict.effects == ("joint_friction", "torque_scale")
    assert verdict.where.joints == ("shoulder", "elbow")
    size = verdict.parameters["joint_friction.shoulder.torque_n_m"]
    assert (size.value, size.unit) == (pytest.approx(0.1, rel=0.05), "N·m")
    assert verdict.gap.removed_fraction > 0.95
    write_amended(tmp_path, robot, first.amended, {})
    amended, beside = load_amended(tmp_path)
    second = diagnose(read_robot_recording(path, amended), amended, beside)
    assert second.verdict.effects == ("none",)
    (stands,) = second.verdict.earlier  # friction is in the MJCF
    assert (stands.effect, stands.places) == ("torque_scale", ("elbow",))
    assert stands.outcome in ("stands", "changed")
    assert "amended model's torque scale at elbow is confirmed" in earlier_sentence(
        stands, of_robot=True
    )
    assert second.verdict.gap.before_n < 1.1 * first.verdict.gap.after_n
    write_amended(tmp_path, amended, second.amended, beside)
    again = load_amended(tmp_path)[1][Term("torque_scale", "elbow", "share")]
    assert again == pytest.approx(0.2, abs=0.03)
