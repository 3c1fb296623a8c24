"""The examples that need nodes: each runs, and the controller stops when it must."""

import time

import numpy as np
import pytest
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from cablesense_sim.arm import open_arm
from examples.admittance.__main__ import metrics, play
from examples.back_off import LIMIT_RAD, THRESHOLD_N

CONTROLLER = "examples.admittance.controller_node"
HEALTHY = "healthy_tensions"


def test_the_admittance_controller_backs_off_from_a_wall_and_returns(tmp_path):
    found = play(14.0, tmp_path)
    assert found["without_controller_n"] > 25.0
    assert found["settled_n"] < 0.25 * found["without_controller_n"]
    assert found["steps"] > 2
    assert found["left_from_home_deg"] < 0.5


@pytest.mark.timeout(300)
def test_a_reader_prints_the_force_and_a_controller_backs_off_above_its_threshold(graph, start):
    commands = []
    graph.node.create_subscription(JointState, "/joint_commands", commands.append, 100)
    start("sim")
    start("estimator")
    reader = start("examples.read_topics")
    controller = start("examples.back_off")
    graph.until(lambda: "free" in reader.log, "a free arm")
    straight = JointState(name=list(open_arm("cdsm").joint_names), position=[0.0] * 8)
    graph.command.publish(straight)  # or the first step drops the tare
    graph.until(lambda: commands, "the command")
    commands.clear()
    graph.push(3, (0.0, 0.75 * THRESHOLD_N, 0.0))
    graph.until(lambda: "contact on segment_3: (" in reader.log, "the contact, read")
    graph.until(lambda: "contact on segment_3: (" in controller.log, "the contact, controlled")
    assert not commands
    graph.push(3, (0.0, 1.5 * THRESHOLD_N, 0.0))
    graph.until(lambda: len(commands) > 1, "two steps")
    turned = dict(zip(commands[-1].name, commands[-1].position, strict=True))
    assert 0.0 < turned["joint_1_yaw"] <= LIMIT_RAD
    assert turned["joint_4_yaw"] == pytest.approx(0.0, abs=1e-6)


def test_metrics_are_those_of_the_contact():
    times = np.arange(0.0, 20.0, 0.04)
    pressed = (times >= 1.0) & (times < 10.0)
    decay = 2.0 + 28.0 * np.exp(-(times - 1.0) * np.log(28.0) / 3.0)
    commands = np.zeros((len(times), 8))
    commands[(times >= 2.0) & (times < 15.0), 3] = 0.01
    unyielding = np.where(pressed, 30.0, 0.0)
    found = metrics(times, np.where(pressed, decay, 0.0), unyielding, commands, 10.0)
    assert found["without_controller_n"] == pytest.approx(30.0)
    assert found["settled_n"] == pytest.approx(2.0, abs=0.01)
    assert found["settling_s"] == pytest.approx(3.0, abs=0.1)
    assert (found["steps"], found["left_from_home_deg"]) == (1, 0.0)


@pytest.mark.timeout(180)
def test_a_failing_channel_moves_no_arm_and_a_killed_estimator_stops_it(graph, start):
    """The sim's tensions pass through this process, where a channel fails."""
    exchanged = False
    commands = []

    def pass_on(message):
        if exchanged:
            message.effort[2], message.effort[7] = message.effort[7], message.effort[2]
        out.publish(message)

    out = graph.node.create_publisher(JointState, "/cable_tensions", 10)
    graph.node.create_subscription(JointState, f"/{HEALTHY}", pass_on, qos_profile_sensor_data)
    graph.node.create_subscription(JointState, "/joint_commands", commands.append, 100)
    estimator = start("estimator")
    start("sim", remaps={"cable_tensions": HEALTHY})
    controller = start(CONTROLLER, resume_after_s=0.5)
    trusted = "estimates are trusted"
    graph.until(lambda: trusted in controller.log, "the controller's trust")
    exchanged = True
    graph.until(lambda: "stopped: " in controller.log, "a stop")
    graph.until(lambda: "sample refused" in estimator.log, "the estimator's refusal")
    graph.spin(0.5)
    turned_rad = max((np.abs(command.position).max() for command in commands), default=0.0)
    assert np.rad2deg(turned_rad) <= 0.5
    exchanged = False
    trusts = controller.log.count(trusted)
    graph.until(lambda: controller.log.count(trusted) > trusts, "trust again")
    stops = controller.log.count("stopped: no state of the force")
    estimator.kill()
    commands.clear()
    stop = "stopped: no state of the force"
    graph.until(lambda: controller.log.count(stop) > stops, "a stop")
    time.sleep(0.3)
    graph.spin(0.2)
    assert not commands
