"""What a node is sent at its edges: floods, no clock, a lifecycle manager, signals at any time."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from rclpy.serialization import serialize_message
from ros_graph import NodeProcess
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

rclpy = pytest.importorskip("rclpy")


pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

SIM, ESTIMATOR = "cablesense_ros.sim_node", "cablesense_ros.estimator_node"


def test_huge_messages_are_refused_unread_and_leave_no_memory_behind(graph):
    process = NodeProcess(ESTIMATOR, namespace="/flooded")
    samples, commands = (
        graph.node.create_publisher(JointState, f"/flooded/{topic}", 100)
        for topic in ("cable_tensions", "joint_commands")
    )
    for publisher in (samples, commands):
        graph.until(publisher.get_subscription_count, "the estimator")
    commands.publish(JointState(name=["x"] * 100_000))
    before_mb = _resident_mb(process.pid)
    huge = serialize_message(JointState(effort=[0.0] * 1_000_000))
    for _ in range(100):
        samples.publish(huge)
        graph.spin(0.02)
    for topic in ("cable_tensions: sample refused", "joint_commands: message refused"):
        graph.until(
            lambda topic=topic: re.search(rf"{topic}: \d+ bytes; a message", process.log),
            f"{topic} in the log",
        )
    graph.spin(1.0)
    assert _resident_mb(process.pid) < before_mb + 250
    for publisher in (samples, commands):
        graph.node.destroy_publisher(publisher)
    assert process.stop() == 0, process.log


def _resident_mb(pid):
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096 / 1e6


def test_without_a_clock_or_with_one_before_1970_the_node_goes_on_and_says_so(graph):
    process = NodeProcess(ESTIMATOR, namespace="/simulated", use_sim_time=True)
    wrenches = graph.listen(WrenchStamped, "/simulated/estimator/wrench")
    graph.until(lambda: len(wrenches) > 10, "zero wrenches, though no time passes")
    graph.until(lambda: "/clock has not begun" in process.log, "the missing clock in the log")
    graph.until(lambda: "simulated/estimator: clock" in graph.statuses, "it in diagnostics")
    clock = graph.node.create_publisher(Clock, "/clock", 10)
    graph.until(clock.get_subscription_count, "the estimator")
    message = Clock()
    message.clock.sec = -5

    def refused():
        clock.publish(message)
        return "/clock is -5 s: refused" in process.log or not process.alive

    graph.until(refused, "the refusal in the log")
    message.clock.sec = 6
    clock.publish(message)
    graph.spin(0.5)
    assert process.alive
    assert process.stop() == 0, process.log
    assert "Traceback" not in process.log
    graph.node.destroy_publisher(clock)


def test_a_lifecycle_manager_brings_it_up_and_down_and_up_again(graph):
    name = "/managed/estimator"
    process = NodeProcess(ESTIMATOR, namespace="/managed", autostart=False)
    wrenches = []
    wrench_in = graph.node.create_subscription(
        WrenchStamped, f"{name}/wrench", wrenches.append, 10
    )
    for _ in range(2):
        assert graph.change_state(name, Transition.TRANSITION_CONFIGURE), process.log
        assert not graph.call(f"{name}/tare").success
        assert graph.change_state(name, Transition.TRANSITION_ACTIVATE)
        wrenches.clear()
        graph.until(lambda: wrenches, "zero wrenches without a source")
        assert graph.change_state(name, Transition.TRANSITION_DEACTIVATE)
        assert graph.change_state(name, Transition.TRANSITION_CLEANUP)
    assert graph.change_state(name, Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    graph.until(lambda: "managed/estimator: lifecycle" in graph.statuses, "its end in diagnostics")
    assert "shut down" in graph.statuses["managed/estimator: lifecycle"].message
    graph.node.destroy_subscription(wrench_in)
    assert process.stop() == 0, process.log
    assert "Traceback" not in process.log


def test_ctrl_c_while_the_modules_are_read_leaves_no_traceback(graph):
    process = NodeProcess(SIM, namespace="/early")

    def takes_sigterm():
        caught = re.search(r"SigCgt:\s*(\w+)", Path(f"/proc/{process.pid}/status").read_text())
        return int(caught.group(1), 16) >> (signal.SIGTERM - 1) & 1

    graph.until(takes_sigterm, "the package")
    process.signal(signal.SIGINT)
    assert process.wait() == 0, process.log
    assert "Traceback" not in process.log


@pytest.mark.parametrize(
    "numbers",
    [
        (signal.SIGTERM, signal.SIGINT, signal.SIGINT),
        (signal.SIGHUP, signal.SIGHUP, signal.SIGTERM),
    ],
    ids=lambda numbers: numbers[0].name,
)
def test_a_signal_after_a_request_to_end_does_not_cut_the_end_short(graph, numbers):
    process = NodeProcess(SIM, namespace="/ending")
    graph.until(lambda: "cables at" in process.log, "the sim")
    for number in numbers:
        process.signal(number)
        time.sleep(0.02)
    assert process.wait() == 0, process.log
    assert "Traceback" not in process.log


# as Fast DDS does where a participant is discovered at that moment
NEVER_GONE = """
import ctypes
from rclpy.node import Node
from cablesense_ros import node_process

class NeverGone(Node):
    def __init__(self):
        super().__init__("never_gone")
        print("up", flush=True)

    def destroy_node(self):
        ctypes.PyDLL(None).pause()

node_process._DESTROYED_AFTER_S = 0.5
raise SystemExit(node_process.run_node(NeverGone))
"""


def test_a_node_whose_destruction_never_comes_back_ends():
    process = subprocess.Popen([sys.executable, "-c", NEVER_GONE], stdout=subprocess.PIPE)
    with process:
        assert process.stdout.readline() == b"up\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=20.0) == 1
