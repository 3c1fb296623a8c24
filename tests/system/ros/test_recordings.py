"""Runs of real nodes are recorded over Fast DDS: read for a diagnosis, replayed bit for bit."""

import signal
import subprocess
import sys

import numpy as np
import pytest
from rich.console import Console
from sensor_msgs.msg import JointState

from cablesense_msgs_py.qos import INPUTS
from cablesense_online.replay import RecordedRun, replay_in_process
from cablesense_recording.mcap_messages import McapMessages
from cablesense_recording.reading import read_recording
from cablesense_recording.recording import RecordingError
from cablesense_ros import recorder
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from tests.helpers.checkout import CHECKOUT
from tests.helpers.ros_graph import Graph

LAB = open_arm("cdsm_lab")
COMMAND = [sys.executable, "-c", "from cablesense_ros.cli.app import main; main()"]
SAME_SHARE = 0.9
"""A recorder may see a command before the sample that the estimator saw first."""


def record(*arguments):
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=CHECKOUT,
    )


class RecordingGraph(Graph):
    """Moves the arm of what is recorded."""

    def move(self, angle_rad):
        names = list(LAB.joint_names)
        self.command.publish(JointState(name=names, position=[angle_rad] * 8))

    def move_until_recorders(self, count):
        """Move to and fro within 0.01 rad until so many recorders listen beside the nodes."""
        to = 0.1

        def all_listen():
            nonlocal to
            to = 0.19 - to
            self.move(to)
            self.spin(0.15)
            return self.command.get_subscription_count() == 2 + count

        self.until(all_listen, f"{count} recorders")


@pytest.fixture
def graph():
    talking = RecordingGraph()
    yield talking
    talking.close()


def test_what_the_sim_node_publishes_becomes_a_recording(graph, start, tmp_path):
    out = tmp_path / "made.mcap"
    start("sim", arm="cdsm_lab", rate_hz=50.0)
    recording = record("gap", "record", "--out", out, "--arm", "cdsm_lab")
    try:
        graph.until(lambda: graph.tensions, "the sim")
        graph.until(lambda: graph.command.get_subscription_count() == 2, "sim and recorder")
        graph.move(0.0)
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
        printed, _ = recording.communicate(timeout=60)
    assert recording.returncode == 0, printed
    assert "applied_wrench: left out" in printed
    assert "warn: has only" in printed
    got = read_recording(out, LAB)
    assert len(got) > 80
    assert np.median(np.diff(got.time_s)) == pytest.approx(0.02, abs=0.005)
    assert set(got.load_segment) == {0, 3}
    loaded = got.rows(got.load_segment == 3)
    np.testing.assert_array_equal(loaded.load_n, np.tile([0.0, 12.0, 0.0], (len(loaded), 1)))
    settled = loaded.rows(slice(len(loaded) // 2, None))
    nominal = solve_equilibrium(mechanism_of(LAB), settled.command_rad, settled.forces_n)
    assert np.abs((settled.tensions_n - nominal.tensions_n).mean(axis=0)).max() < 0.3
    assert [path.name for path in tmp_path.iterdir()] == ["made.mcap"]


def test_silence_leaves_no_file_and_says_what_may_help(tmp_path):
    with pytest.raises(RecordingError, match=r"nothing on cable_tensions in .* is the arm's"):
        recorder.record_topics(tmp_path / "none.mcap", INPUTS, 0.6, LAB, Console())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("a.csv", "must be named"), ("there.mcap", "exists already"), ("no/a.mcap", "No such file")],
)
def test_a_name_that_cannot_be_is_one_line(name, remedy, tmp_path):
    (tmp_path / "there.mcap").write_text("kept", encoding="utf-8")
    with pytest.raises(RecordingError, match=remedy) as refused:
        recorder.record_topics(tmp_path / name, INPUTS, 1.0, LAB, Console())
    assert "\n" not in str(refused.value)
    assert (tmp_path / "there.mcap").read_text(encoding="utf-8") == "kept"


@pytest.mark.timeout(180)
def test_recorded_whole_and_killed_late(graph, start, tmp_path):
    """A whole recording, and one that joins late and is killed."""
    whole, late = (tmp_path / f"{name}.mcap" for name in ("whole", "late"))
    start("sim")
    recording = record("record", "--out", whole)
    joins = None
    try:
        graph.until(
            lambda: whole.exists() and whole.stat().st_size > 1000, "the recording to grow"
        )
        estimator = start("estimator", tare_samples=20, tare_force=True)
        graph.until(lambda: "tare taken" in estimator.log, "the first tare")
        graph.until(
            lambda: graph.command.get_subscription_count() == 3, "sim, estimator, recorder"
        )
        graph.push(3, (0.0, 40.0, 0.0))
        graph.move(0.0)  # to the assumed pose, or the next would drop the tare
        graph.spin(1.0)  # the contact, which the next tare takes as unloaded
        joins = record("record", "--out", late)
        graph.move_until_recorders(2)
        graph.move(0.01)

        def tared():
            graph.spin(0.3)
            return graph.call("/estimator/tare").success

        graph.until(tared, "a tare at the new pose")
        graph.spin(1.0)
        joins.kill()
        graph.push(3, (0.0, 0.0, 0.0))
        graph.spin(0.3)
        assert graph.call("/estimator/tare_undo").success
        graph.spin(0.3)
    finally:
        if joins:
            joins.kill()
            joins.communicate(timeout=60)
        recording.send_signal(signal.SIGINT)
        printed, _ = recording.communicate(timeout=60)
    assert recording.returncode == 0, printed
    run = RecordedRun(whole)
    assert run.cut == ""
    got = replay_in_process(run)
    assert got.compared > 200
    assert got.contacts > 50
    assert got.identical > SAME_SHARE * got.compared, got.first_difference
    broken = RecordedRun(late)
    after_kill = replay_in_process(broken)
    assert "breaks off" in broken.cut
    assert after_kill.identical > 50, after_kill.first_difference  # it begins in mid-move
    recorded = {message.topic for message in McapMessages(whole)}
    assert {"/applied_wrench", "/estimator/calibration", "/estimator/wrench_upper"} < recorded
    assert {"/diagnostics", "/joint_states", "/robot_description"} < recorded
