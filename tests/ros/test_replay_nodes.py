"""A run of real nodes, recorded by the command and replayed bit for bit."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from ros_graph import Graph, NodeProcess
from sensor_msgs.msg import JointState

from cablesense_gap.recordings.mcap_messages import McapMessages
from cablesense_msgs_py.qos import CONTRACT
from cablesense_online.replay import RecordedRun, replay_in_process
from cablesense_online.state import EventKind
from cablesense_ros.recorder import Recorder
from cablesense_sim.arm import open_arm

pytest.importorskip("rclpy", reason="needs ROS 2, or its wheels", exc_type=ImportError)


pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

ARM = open_arm("cdsm")
ROOT = Path(__file__).parents[2]
COMMAND = "from cablesense_ros.cli.app import main; main()"
RECORD = [sys.executable, "-c", COMMAND, "record", "--out"]
SIM, ESTIMATOR = "cablesense_ros.sim_node", "cablesense_ros.estimator_node"


class RecordingGraph(Graph):
    """Records what comes from some time on; the file is then as a killed recorder leaves it."""

    recorder = None

    def record(self, path):
        self.recorder = Recorder(self.node, path, CONTRACT, None, print)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            super().spin(0.1)
            if self.recorder:
                self.recorder.flush()


def recorded(folder):
    """The files of a whole recording, and of one that joins late and is killed."""
    whole, late, killed = (folder / f"{name}.mcap" for name in ("whole", "late", "killed"))
    graph = RecordingGraph()
    nodes = [NodeProcess(SIM, rate_hz=200.0)]
    recording = subprocess.Popen(
        [*RECORD, str(whole)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
    )
    try:
        graph.until(
            lambda: whole.exists() and whole.stat().st_size > 1000, "the recording to grow"
        )
        estimator = NodeProcess(ESTIMATOR, tare_samples=20, tare_force=True)
        nodes.append(estimator)
        graph.until(lambda: "tare taken" in estimator.log, "the first tare")
        graph.until(
            lambda: graph.command.get_subscription_count() == 3, "sim, estimator, recorder"
        )
        graph.push(3, (0.0, 40.0, 0.0))
        # to the assumed pose, or the next, which changes tensions by 2 N, would drop the tare
        graph.command.publish(JointState(name=list(ARM.joint_names), position=[0.0] * 8))
        graph.spin(0.1)
        graph.command.publish(JointState(name=list(ARM.joint_names), position=[0.1] * 8))
        graph.spin(0.2)
        graph.record(late)  # joins in mid-move
        graph.until(lambda: graph.command.get_subscription_count() == 4, "the second recorder")
        graph.command.publish(JointState(name=list(ARM.joint_names), position=[0.01] * 8))
        graph.spin(1.8)
        assert graph.call("/estimator/tare").success
        graph.spin(1.0)
        shutil.copy(late, killed)
        graph.push(3, (0.0, 0.0, 0.0))
        graph.spin(0.3)
        assert graph.call("/estimator/tare_undo").success
        graph.spin(0.3)
    finally:
        if graph.recorder:
            graph.recorder.close()
        recording.send_signal(signal.SIGINT)
        printed, _ = recording.communicate(timeout=30)
        codes = [process.stop() for process in reversed(nodes)]
        graph.close()
    assert codes == [0, 0], estimator.log
    assert recording.returncode == 0, printed
    return whole, killed


def test_recorded_whole_and_killed_late(tmp_path):
    whole, killed = recorded(tmp_path)
    run = RecordedRun(whole)
    assert run.cut == ""
    got = replay_in_process(run)
    assert 400 < got.compared == got.identical
    assert got.contacts > 50
    assert got.lone_contacts == 0
    kinds = [event.kind for state in run.states for event in state.events]
    kinds = [kind for kind in kinds if kind is not EventKind.MISFIT]  # the arm swings
    assert kinds == [
        EventKind.START,
        EventKind.AUTO_TARE,
        EventKind.POSE_CONFIRMED,
        EventKind.COMMAND,
        EventKind.COMMAND,
        EventKind.TARE,
        EventKind.TARE_UNDO,
    ]
    broken = RecordedRun(killed)
    after_kill = replay_in_process(broken)
    assert "breaks off" in broken.cut
    assert 100 < after_kill.compared == after_kill.identical
    assert {message.topic for message in McapMessages(whole)} == {
        "/applied_wrench",
        "/cable_tensions",
        "/diagnostics",
        "/estimator/contact_point",
        "/estimator/contact_probabilities",
        "/estimator/force_direction",
        "/estimator/joint_torques",
        "/estimator/journal",
        "/estimator/markers",
        "/estimator/status",
        "/estimator/wrench",
        "/estimator/wrench_base",
        "/estimator/wrench_lower",
        "/estimator/wrench_upper",
        "/joint_commands",
        "/joint_states",
        "/robot_description",
    }
