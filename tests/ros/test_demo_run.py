"""The demo: which nodes each combination of options starts, and a headless run of each kind."""

import json

import pytest
from arm_variants import five_by_four, five_by_four_text
from typer.testing import CliRunner

from cablesense_ros.cli import runs
from cablesense_ros.cli.app import app
from cablesense_ros.demo import run
from cablesense_ros.demo.run import DemoOptions, Source, node_commands, run_headless

SOURCES = {Source.SIM: ["sim"], Source.CAN: ["can_emulator", "can_driver", "sim"]}


@pytest.mark.parametrize("live", [True, False])
@pytest.mark.parametrize("source", Source)
def test_the_nodes_are_those_of_the_source(source, live, tmp_path):
    options = DemoOptions(out=tmp_path, seed=3, source=source)
    commands = node_commands(options, live)
    page = ["page"] if live else []
    assert list(commands) == [*SOURCES[source], "estimator", *page]
    assert "seed:=3" in commands["sim"]
    if source is Source.SIM:
        assert "-r" not in commands["sim"]
    else:
        link = f'channel:="{tmp_path}/can_adapter"'
        assert link in commands["can_emulator"]
        assert link in commands["can_driver"]
        assert "cable_tensions:=simulated_tensions" in commands["sim"]


def test_a_model_of_several_contacts_can_be_shown(tmp_path):
    assert run._check_files(DemoOptions(model="cdsm_multi", out=tmp_path)).name == "cdsm"


def test_breathing_keeps_an_arm_that_is_asked_for(tmp_path, monkeypatch):
    played = []
    monkeypatch.setattr(runs, "run_headless", lambda options, **_: played.append(options))
    for asked in ([], ["--arm", "cdsm"]):
        command = ["demo", "--headless", "--breathe", "--out", str(tmp_path), *asked]
        assert CliRunner().invoke(app, command).exit_code == 0
    assert [options.arm for options in played] == ["cdsm_friction", "cdsm"]


@pytest.mark.parametrize(
    ("screens", "opened"), [({}, []), ({"DISPLAY": ":0"}, ["http://page/"])], ids=["none", "X"]
)
def test_the_page_opens_where_there_is_a_screen(monkeypatch, screens, opened):
    found = []
    monkeypatch.setattr(run.webbrowser, "open", found.append)
    monkeypatch.setattr(run.sys, "platform", "linux")
    monkeypatch.setattr(run.os, "environ", screens)
    run._open_in_browser("http://page/")
    assert found == opened


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_push_is_estimated_through_can_frames(tmp_path, capfd):
    pytest.importorskip("rclpy")
    options = DemoOptions(out=tmp_path, source=Source.CAN)
    run_headless(options, duration_s=4.0, as_json=True)
    found = json.loads(capfd.readouterr().out)["summary"]
    assert found["pushes"] == found["segment_right"] > 0
    assert found["magnitude_mae_n"] < 2.0


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_an_arm_of_five_segments_with_four_cables_is_pushed(tmp_path, capfd):
    pytest.importorskip("rclpy")
    arm = tmp_path / "arm.yaml"
    arm.write_text(five_by_four_text(), encoding="utf-8")
    model = tmp_path / "model.onnx"
    small = ["--network", "closed-form", "--samples", "300", "--out", str(model)]
    trained = CliRunner().invoke(app, ["train", "--arm", str(arm), *small])
    assert trained.exit_code == 0, trained.output
    options = DemoOptions(arm=str(arm), model=str(model), out=tmp_path)
    run_headless(options, duration_s=4.0, as_json=True)
    found = json.loads(capfd.readouterr().out)
    assert found["arm"] == five_by_four().identity
    assert found["summary"]["pushes"] == found["summary"]["estimated"] == 1
    assert (tmp_path / "demo.png").is_file()
