"""The examples that need nodes: each runs, and the controllers stop when they must."""

import subprocess
import sys

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.duration import Duration
from sensor_msgs.msg import JointState

from cablesense_msgs_py.messages import ForceState
from cablesense_sim.arm import open_arm
from examples import admittance
from examples.back_off import LIMIT_RAD, THRESHOLD_N
from tests.helpers.checkout import CHECKOUT

JOINTS = list(open_arm("cdsm").joint_names)


@pytest.mark.timeout(300)
def test_a_reader_prints_the_force_and_a_controller_backs_off_above_its_threshold(graph, start):
    commands = []
    graph.node.create_subscription(JointState, "/joint_commands", commands.append, 100)
    start("sim")
    start("estimator")
    reader = start("examples.read_topics")
    controller = start("examples.back_off")
    graph.until(lambda: "free" in reader.log, "a free arm")
    straight = JointState(name=JOINTS, position=[0.0] * 8)
    readers = 3  # sim, estimator and this test: a command that one of them misses drops the tare
    graph.until(lambda: graph.command.get_subscription_count() == readers, "all readers")
    graph.command.publish(straight)  # or the first step drops the tare
    graph.until(lambda: commands, "the command")
    commands.clear()
    pushed = ("segment_3", "0", f"{0.75 * THRESHOLD_N:g}", "0")
    subprocess.run((sys.executable, "-m", "examples.push", *pushed), cwd=CHECKOUT, check=True)
    graph.until(lambda: "contact on segment_3: (" in reader.log, "the contact, read")
    graph.until(lambda: "contact on segment_3: (" in controller.log, "the contact, controlled")
    assert not commands
    graph.push(3, (0.0, 1.5 * THRESHOLD_N, 0.0))
    graph.until(lambda: len(commands) > 1, "two steps")
    turned = dict(zip(commands[-1].name, commands[-1].position, strict=True))
    assert 0.0 < turned["joint_1_yaw"] <= LIMIT_RAD
    assert turned["joint_4_yaw"] == pytest.approx(0.0, abs=1e-6)


class StatedForce:
    """Publishes what an estimator would, 50 times a second."""

    def __init__(self, graph):
        self.graph = graph
        self.status_out = graph.node.create_publisher(DiagnosticArray, "/estimator/status", 10)
        self.torques_out = graph.node.create_publisher(JointState, "/estimator/joint_torques", 10)

    def hold(self, seconds, state, torques_n_m, age_s=0.0):
        """State it for a while, of samples that are `age_s` old."""
        for _ in range(round(seconds / 0.02)):
            stamp = (self.graph.node.get_clock().now() - Duration(seconds=age_s)).to_msg()
            torques = JointState(name=JOINTS, effort=torques_n_m)
            torques.header.stamp = stamp
            status = DiagnosticArray(status=[DiagnosticStatus(message=state.value)])
            status.header.stamp = stamp
            self.torques_out.publish(torques)
            self.status_out.publish(status)
            self.graph.spin(0.02)


@pytest.fixture
def stated(graph):
    force = StatedForce(graph)
    yield force
    graph.node.destroy_publisher(force.status_out)
    graph.node.destroy_publisher(force.torques_out)


def test_the_admittance_controller_answers_fresh_states_that_are_vouched_for_alone(
    graph, start, stated
):
    start("examples.admittance")
    commands = graph.listen(JointState, "/joint_commands")
    begin_rad = np.linspace(-0.1, 0.2, 8)
    states_out = graph.node.create_publisher(JointState, "/joint_states", 10)
    graph.until(states_out.get_subscription_count, "a reader of joint_states")
    graph.until(stated.status_out.get_subscription_count, "a reader of the states")
    torques_n_m = [0.0, 40.0, 0.0, 20.0, 0.0, 0.0, 0.0, 0.0]
    stated.hold(0.3, ForceState.CONTACT, torques_n_m)
    assert not commands  # where the arm is is not known yet
    states_out.publish(JointState(name=JOINTS, position=begin_rad.tolist()))
    stated.hold(1.0, ForceState.CONTACT, torques_n_m)
    turned_rad = np.diff([begin_rad, *(command.position for command in commands)], axis=0)
    assert np.abs(turned_rad).max() <= admittance.FASTEST_RAD_S * admittance.PERIOD_S + 1e-9
    assert turned_rad[:, 1].min() > 0.0
    assert turned_rad[:, 3] == pytest.approx(0.5 * turned_rad[:, 1])
    for state, age_s in (
        *((state, 0.0) for state in ForceState if not state.known),
        (ForceState.CONTACT, 2.0 * admittance.STALE_AFTER_S),
        (ForceState.CONTACT, -2.0 * admittance.STALE_AFTER_S),
    ):
        stated.hold(1.2 * admittance.STALE_AFTER_S, state, torques_n_m, age_s)
        commands.clear()
        stated.hold(0.2, state, torques_n_m, age_s)
        assert not commands, (state, age_s)
    stated.hold(0.5, ForceState.MOMENT, torques_n_m)
    assert commands
    graph.spin(2.0 * admittance.STALE_AFTER_S)  # silence
    commands.clear()
    graph.spin(0.3)
    assert not commands
    graph.node.destroy_publisher(states_out)
    graph.forget()


@pytest.mark.timeout(300)
def test_an_arm_with_the_admittance_controller_gives_way_and_a_killed_estimator_stops_it(
    graph, start
):
    estimator = start("estimator")
    start("sim")
    controller = start("examples.admittance")
    commands = graph.listen(JointState, "/joint_commands")
    graph.until(lambda: "yields to contacts" in controller.log, "a free arm")
    graph.push(3, (0.0, 20.0, 0.0))
    graph.until(lambda: len(commands) > 50, "a second of motion")
    turned = dict(zip(commands[-1].name, commands[-1].position, strict=True))
    assert turned["joint_1_yaw"] > turned["joint_3_yaw"] > 0.001
    assert turned["joint_4_yaw"] == pytest.approx(0.0, abs=1e-4)
    assert turned["joint_1_pitch"] == pytest.approx(0.0, abs=1e-3)
    silence = "holds: no fresh estimate"
    stops = controller.log.count(silence)
    estimator.kill()
    graph.until(lambda: controller.log.count(silence) > stops, "a stop")
    graph.spin(0.2)
    commands.clear()
    graph.spin(0.5)
    assert not commands
    graph.forget()
