"""Diagnoses with a model that leaves a tenth of the torque, mostly since a healthy recording."""

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from cablesense_gap.reference import Reference, problem_since
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import RobotSystem, diagnose
from cablesense_gap.simulator import Term
from cablesense_gap.system import problem_of
from cablesense_gap.verdict import read_verdict
from cablesense_gap.watch import SeriesError
from cablesense_recording.recording import RecordingError
from cablesense_ros.cli.app import app
from tests.helpers.html_page import show_no_film
from tests.helpers.two_link import worn, write_model


@pytest.mark.slow
def test_without_a_reference_it_names_what_stands_out_of_the_model_s_error(tmp_path):
    robot = load_robot(write_model(tmp_path))
    later = read_robot_recording(worn(tmp_path / "later.csv", 3, payload=0.5), robot)
    loaded = diagnose(later, robot).verdict
    assert loaded.effects == ("payload",)
    assert loaded.parameters["payload.mass_kg"].value == pytest.approx(0.5, rel=0.2)
    assert "models of real machines do" in loaded.doubts[0]
    assert loaded.probability == 0.5


@pytest.mark.slow
def test_the_command_says_since_when_and_refuses_another_machine(tmp_path, monkeypatch):
    show_no_film(monkeypatch)
    model = write_model(tmp_path)
    healthy = worn(tmp_path / "healthy.csv", 1)
    later = worn(tmp_path / "later.csv", 3, payload=0.1)
    asked = ["gap", "diagnose", later, "--model", model, "--out", tmp_path / "out"]
    since = ["--reference", str(healthy), "--workers", "1"]
    ran = CliRunner().invoke(app, [*map(str, asked), *since])
    assert ran.exit_code == 0, ran.output
    assert "since the reference" in ran.output
    assert "since the reference" in (tmp_path / "out" / "report.html").read_text()
    verdict = read_verdict(tmp_path / "out" / "verdict.json")
    assert verdict.effects == ("payload",)
    assert verdict.reference.recording == "healthy"
    assert verdict.reference.left_n < 0.5 * verdict.reference.before_n
    assert verdict.where.bodies == ("lower",)
    assert verdict.parameters["payload.mass_kg"].value == pytest.approx(0.1, rel=0.2)
    for missing in ("position.elbow", "torque.elbow"):
        pd.read_csv(healthy).drop(columns=missing).to_csv(tmp_path / "other.csv", index=False)
        asked[-1] = tmp_path / missing
        others = [*map(str, asked), "--reference", str(tmp_path / "other.csv")]
        with pytest.raises(RecordingError, match=f"other.*{missing.split('.')[0]}.*elbow"):
            CliRunner().invoke(app, others, catch_exceptions=False)


@pytest.mark.slow
@pytest.mark.parametrize(("zero_rad", "gain"), [(0.25, 1.0), (0.0, 1.3), (0.25, 1.3)])
def test_unmodelled_torques_move_with_a_zero_and_are_read_with_a_torque_s_scale(
    tmp_path, zero_rad, gain
):
    """With the planted numbers, as little is left as of a healthy recording."""
    robot = load_robot(write_model(tmp_path))

    def system(name, *seed, **planted):
        recording = read_robot_recording(worn(tmp_path / name, *seed, **planted), robot)
        return RobotSystem(robot, prepared(recording, robot), {})

    reference = Reference(system("healthy.csv", 1))
    planted = {
        Term("joint_zero", "shoulder", "zero_rad"): zero_rad,
        Term("torque_scale", "shoulder", "share"): gain - 1.0,
    }

    def left(name, values, **more):
        again = system(name, 3, **more).with_listed(reference.known)
        problem = problem_of(again)
        since_then = problem_since(problem, reference.expected(again, problem))
        predicted = since_then.simulator.predict([values])[0]
        return np.sqrt(((since_then.readings - predicted) ** 2).mean())

    healthy = left("again.csv", {})
    assert left("changed.csv", planted, zero_rad=zero_rad, gain=gain) < 1.4 * gain * healthy


@pytest.mark.slow
def test_a_series_of_recordings_shows_what_drifts(dask_address, tmp_path):
    dated = tmp_path / "dated"
    out = tmp_path / "drift"
    dated.mkdir()
    for month, size in enumerate((0.0, 0.0, 0.3), start=1):
        worn(dated / f"2031-0{month}.csv", month, friction=(size, 0.0))
    asked = ["gap", "watch", dated, "--model", write_model(tmp_path), "--out", out]
    asked += ["--dask-scheduler", dask_address]
    ran = CliRunner().invoke(app, [*map(str, asked)])
    assert ran.exit_code == 0, ran.output
    table = pd.read_csv(out / "drift.csv")
    assert table["effects"].tolist() == ["none", "joint_friction"]
    friction = table["joint_friction.shoulder.torque_n_m, N·m"]
    assert friction[1] == pytest.approx(0.3, rel=0.2)
    assert (out / "drift.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(SeriesError, match="holds 0 recordings"):
        CliRunner().invoke(
            app, ["gap", "watch", str(out / "none"), "--out", str(out)], catch_exceptions=False
        )
