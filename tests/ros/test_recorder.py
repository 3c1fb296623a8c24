"""Recording from the real sim node over Fast DDS, and what is printed when nothing comes."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from ros_graph import Graph, NodeProcess
from sensor_msgs.msg import JointState

from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.recordings.recording import RecordingError
from cablesense_msgs_py.qos import INPUTS
from cablesense_ros import recorder
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium

pytest.importorskip("rclpy", reason="needs ROS 2, or its wheels", exc_type=ImportError)


pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

ARM = open_arm("cdsm_lab")
COMMAND = [sys.executable, "-c", "from cablesense_ros.cli.app import main; main()", "gap"]
ROOT = Path(__file__).parents[2]


def record(*arguments):
    return subprocess.Popen(
        [*COMMAND, "record", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
    )


@pytest.fixture
def graph():
    talking = Graph()
    yield talking
    talking.close()


def test_what_the_sim_node_publishes_becomes_a_recording(graph, tmp_path):
    out = tmp_path / "made.mcap"
    sim = NodeProcess("cablesense_ros.sim_node", arm="cdsm_lab", rate_hz=50.0)
    recording = record("--out", out, "--arm", "cdsm_lab")
    try:
        graph.until(lambda: graph.tensions, "the sim")
        graph.until(lambda: graph.command.get_subscription_count() == 2, "sim and recorder")
        straight = JointState(name=list(ARM.joint_names), position=[0.0] * 8)
        graph.command.publish(straight)
        graph.spin(0.6)
        graph.until(lambda: graph.load.get_subscription_count() == 2, "takers of loads")
        graph.push(3, (0.0, 12.0, 0.0))
        graph.spin(1.2)
        graph.push(3, (0.0, 0.0, 0.0))
        graph.push(9, (0.0, 1.0, 0.0))  # breaks the contract, and is left out
        graph.spin(0.6)
    finally:
        for number in (signal.SIGHUP, signal.SIGINT):  # a second does not cut the file short
            recording.send_signal(number)
        printed, _ = recording.communicate(timeout=30)
        assert sim.stop() == 0
    assert recording.returncode == 0, printed
    assert "Traceback" not in printed
    assert "applied_wrench: left out" in printed
    assert "warn: has only" in printed
    got = read_recording(out, ARM)
    assert len(got) > 80
    assert np.median(np.diff(got.time_s)) == pytest.approx(0.02, abs=0.005)
    assert set(got.load_segment) == {0, 3}
    loaded = got.rows(got.load_segment == 3)
    np.testing.assert_array_equal(loaded.load_n, np.tile([0.0, 12.0, 0.0], (len(loaded), 1)))
    assert set(loaded.trial) == {1}
    settled = loaded.rows(slice(len(loaded) // 2, None))
    nominal = solve_equilibrium(
        mechanism_of(ARM), settled.command_rad, settled.forces_n
    ).tensions_n
    assert np.abs((settled.tensions_n - nominal).mean(axis=0)).max() < 0.3
    assert [path.name for path in tmp_path.iterdir()] == ["made.mcap"]


def test_silence_is_reported_and_leaves_no_file(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(recorder, "SILENT_AFTER_S", 0.1)
    with pytest.raises(RecordingError, match="nothing on cable_tensions in "):
        recorder.record_topics(tmp_path / "none.mcap", INPUTS, 0.6, ARM, Console())
    printed = capfd.readouterr().out
    assert "nothing on cable_tensions so far: is the arm's driver" in printed
    assert "nothing on joint_commands so far: publish the command once more" in printed
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("a.csv", "must be named"), ("there.mcap", "exists already"), ("no/a.mcap", "No such file")],
)
def test_a_name_that_cannot_be_is_one_line(name, remedy, tmp_path):
    (tmp_path / "there.mcap").write_text("kept", encoding="utf-8")
    with pytest.raises(RecordingError, match=remedy) as refused:
        recorder.record_topics(tmp_path / name, INPUTS, 1.0, ARM, Console())
    assert "\n" not in str(refused.value)
    assert (tmp_path / "there.mcap").read_text(encoding="utf-8") == "kept"
