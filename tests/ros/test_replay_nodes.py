"""A run of real nodes, recorded by the command, replayed in process and through a live node."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from ros_graph import Graph, NodeProcess
from sensor_msgs.msg import JointState

from cablesense_gap.recordings.mcap_messages import McapMessages
from cablesense_msgs_py import topics
from cablesense_online.recorded_run import RecordedRun
from cablesense_online.state import EventKind
from cablesense_sim.arm import open_arm

pytest.importorskip("rclpy", reason="needs ROS 2, or its wheels", exc_type=ImportError)


pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

ARM = open_arm("cdsm")
ROOT = Path(__file__).parents[2]
CLI = [sys.executable, "-c", "from cablesense_cli.app import main; main()"]
SIM, ESTIMATOR = "cablesense_ros.sim_node", "cablesense_ros.estimator_node"


@pytest.fixture
def graph():
    talking = Graph()
    yield talking
    talking.close()


def record(path):
    return subprocess.Popen(
        [*CLI, "record", "--out", str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
    )


def replay(path, *arguments):
    done = subprocess.run(
        [*CLI, "replay", str(path), "--json", *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        timeout=100,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_recorded_whole_killed_late_and_through_a_node(graph, tmp_path):
    whole, late = tmp_path / "whole.mcap", tmp_path / "late.mcap"
    nodes = [NodeProcess(SIM, rate_hz=200.0)]
    recorder = record(whole)
    recorders = [recorder]
    try:
        graph.until(
            lambda: whole.exists() and whole.stat().st_size > 1000, "the recording to grow"
        )
        estimator = NodeProcess(ESTIMATOR, tare_samples=20)
        nodes.append(estimator)
        graph.until(lambda: "tare taken" in estimator.log, "the first tare")
        graph.until(
            lambda: graph.command.get_subscription_count() == 3, "sim, estimator, recorder"
        )
        graph.push(3, (0.0, 40.0, 0.0))
        graph.command.publish(JointState(name=list(ARM.joint_names), position=[0.02] * 8))
        graph.spin(0.2)
        second = record(late)  # joins in mid-move
        recorders.append(second)
        graph.until(lambda: graph.command.get_subscription_count() == 4, "the second recorder")
        graph.command.publish(JointState(name=list(ARM.joint_names), position=[0.01] * 8))
        graph.spin(2.5)
        assert graph.call("/estimator/tare").success
        graph.spin(0.3)
        second.send_signal(signal.SIGKILL)
        graph.push(3, (0.0, 0.0, 0.0))
        graph.spin(0.5)
        assert graph.call("/estimator/tare_undo").success
        graph.spin(0.5)
    finally:
        for process in recorders:
            process.send_signal(signal.SIGINT)
            said, _ = process.communicate(timeout=30)
        codes = [process.stop() for process in reversed(nodes)]
    assert codes == [0, 0], estimator.log
    assert recorder.returncode == 0, said
    got = replay(whole)
    assert got["cut"] == ""
    assert 400 < got["compared"] == got["identical"]
    assert got["contacts"] > 50
    assert got["lone_contacts"] == 0
    kinds = [event.kind for state in RecordedRun(whole).states for event in state.events]
    assert kinds == [
        EventKind.START,
        EventKind.AUTO_TARE,
        EventKind.COMMAND,
        EventKind.COMMAND,
        EventKind.TARE,
        EventKind.TARE_UNDO,
    ]
    killed = replay(late)
    assert "breaks off" in killed["cut"]
    assert 100 < killed["compared"] == killed["identical"]
    assert {message.topic for message in McapMessages(whole)} == {
        "/applied_wrench",
        "/cable_tensions",
        "/diagnostics",
        "/estimator/contact_point",
        "/estimator/contact_probabilities",
        "/estimator/force_direction",
        "/estimator/journal",
        "/estimator/markers",
        "/estimator/wrench",
        "/joint_commands",
        "/joint_states",
        "/robot_description",
    }
    fresh = NodeProcess(ESTIMATOR, tare_samples=20)
    try:
        again = replay(whole, "--publish")
    finally:
        assert fresh.stop() == 0, fresh.log
    assert again["compared"] == again["identical"] == got["compared"]
    assert "tare of" in fresh.log  # its undo


@pytest.mark.parametrize("missed", [0, 6])
def test_answers_before_the_recorder_had_found_the_estimator_change_nothing(missed, tmp_path):
    from recorded_runs import SETTINGS, MadeRun

    made = MadeRun()
    first = [record for record in made.records if record[0] == topics.WRENCH][:missed]
    path = made.write(tmp_path / "made.mcap", [r for r in made.records if r not in first])
    fresh = NodeProcess(
        ESTIMATOR,
        tare_samples=SETTINGS.tare_samples,
        joint_speed_deg_s=math.degrees(SETTINGS.joint_speed_rad_s),
        settle_s=SETTINGS.settle_s,
    )
    try:
        got = replay(path, "--publish")
    finally:
        assert fresh.stop() == 0, fresh.log
    assert got["unanswered"] == missed
    assert got["identical"] == got["compared"] == 300 - missed
    assert got["contacts"] > 100


def test_without_an_estimator_publishing_says_so(tmp_path):
    from recorded_runs import MadeRun

    path = MadeRun().write(tmp_path / "made.mcap")
    done = subprocess.run(
        [*CLI, "replay", str(path), "--publish"],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        timeout=60,
    )
    assert done.returncode == 2
    assert "no estimator takes /cable_tensions" in done.stderr
    assert done.stderr.count("\n") == 1
