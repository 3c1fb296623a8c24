"""The demo's sources as command lines, and a push felt through CAN frames."""

import json

import pytest

from cablesense_ros.demo.run import DemoOptions, run_headless
from cablesense_ros.demo.source import Source, source_commands


def test_the_sim_alone_publishes_at_once(tmp_path):
    commands = source_commands(Source.SIM, "cdsm", 3, tmp_path)
    assert list(commands) == ["sim"]
    assert "seed:=3" in commands["sim"]
    assert "-r" not in commands["sim"]


def test_with_can_the_sim_goes_through_an_adapter_of_the_same_name(tmp_path):
    commands = source_commands(Source.CAN, "cdsm", 3, tmp_path)
    assert list(commands) == ["can_emulator", "can_driver", "sim"]
    link = f'channel:="{tmp_path}/can_adapter"'
    assert link in commands["can_emulator"]
    assert link in commands["can_driver"]
    assert "cable_tensions:=simulated_tensions" in commands["sim"]


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_push_is_estimated_through_can_frames(tmp_path, capfd):
    pytest.importorskip("rclpy")
    options = DemoOptions(
        arm="cdsm",
        model="",
        host="127.0.0.1",
        port=0,
        out=tmp_path,
        seed=0,
        source=Source.CAN,
    )
    run_headless(options, duration_s=4.0, as_json=True)
    found = json.loads(capfd.readouterr().out)["summary"]
    assert found["pushes"] == found["segment_right"] > 0
    assert found["magnitude_mae_n"] < 2.0
