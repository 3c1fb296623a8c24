"""Two publishers of tensions, or two estimators: one is used, and the other is an error."""

import time

import numpy as np
import pytest
from sensor_msgs.msg import JointState

from cablesense_msgs_py.messages import Level
from cablesense_msgs_py.qos import INPUTS
from cablesense_online.page.live_machine import LiveMachine
from cablesense_online.page.shown_arm import ShownArm
from cablesense_recording.reading import read_recording
from cablesense_ros.machine_client import MachineClient
from cablesense_ros.recorder import Recorder
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from tests.helpers.ros_graph import Graph, force

ARM = open_arm("cdsm")
PUSH_N = np.zeros((4, 3))
PUSH_N[2] = (0.0, 60.0, 0.0)
UNLOADED, PUSHED = (
    solve_equilibrium(mechanism_of(ARM), np.zeros(8), load).tensions_n for load in (None, PUSH_N)
)


class Source:
    """A publisher of tensions that do not change."""

    def __init__(self, graph, tensions):
        self.node = graph.node
        self.publisher = self.node.create_publisher(JointState, "/cable_tensions", 10)
        self.message = JointState(name=list(ARM.cable_names), effort=tensions.tolist())

    def publish(self):
        self.message.header.stamp = self.node.get_clock().now().to_msg()
        self.publisher.publish(self.message)


def until(graph, sources, condition, what):
    """Let the sources publish in turn, at 100 Hz each, until something is true."""

    def published():
        for source in sources:
            source.publish()
        graph.spin(0.01)
        return condition()

    graph.until(published, what)


@pytest.fixture
def graph():
    talking = Graph()
    yield talking
    talking.close()


def test_the_page_shows_one_and_says_that_there_is_another(graph):
    live = LiveMachine(ShownArm(ARM), joint_speed_rad_s=1.0)
    MachineClient(graph.node, live, "estimator")
    first = Source(graph, UNLOADED)
    second = Source(graph, PUSHED)
    until(graph, [first], lambda: live.snapshot(0.0).readings is not None, "tensions")
    assert live.snapshot(time.monotonic()).status.level is Level.STALE  # no estimator
    shown = set()

    def another_is_reported():
        snapshot = live.snapshot(time.monotonic())
        shown.add(tuple(snapshot.readings))
        return snapshot.status.level is Level.ERROR and len(graph.tensions) > 100

    until(graph, [first, second], another_is_reported, "an error")
    assert "two publishers" in live.snapshot(time.monotonic()).status.notes[0]
    assert shown == {tuple(UNLOADED)}


def test_one_is_recorded(graph, tmp_path):
    out = tmp_path / "made.mcap"
    recorder = Recorder(graph.node, out, INPUTS, ARM)
    first = Source(graph, UNLOADED)
    second = Source(graph, PUSHED)
    graph.until(graph.command.get_subscription_count, "the recorder")
    graph.command.publish(JointState(name=list(ARM.joint_names), position=[0.0] * 8))
    until(graph, [first], lambda: recorder.counts["cable_tensions"], "a row")
    until(graph, [first, second], lambda: recorder.counts["cable_tensions"] > 50, "rows")
    assert "left out" in recorder.status
    recorder.close()
    recorded_n = read_recording(out, ARM).tensions_n
    np.testing.assert_array_equal(recorded_n, np.tile(UNLOADED, (len(recorded_n), 1)))


def test_one_is_used_until_it_ends_then_the_other_after_a_wait(graph, start):
    estimator = start("estimator")
    first = Source(graph, UNLOADED)
    until(graph, [first], lambda: "tare taken" in estimator.log, "the tare")
    second = Source(graph, PUSHED)
    both = [first, second]
    graph.wrenches.clear()
    graph.statuses.clear()

    def level(part):
        status = graph.statuses.get(f"estimator: {part}")
        return (-1, "") if status is None else (status.level[0], status.message)

    until(graph, both, lambda: level("cable_tensions")[0] == 2, "an error")
    until(graph, both, lambda: len(graph.wrenches) > 60, "wrenches")
    assert "2 publishers" in level("cable_tensions")[1]
    assert {force(wrench) for wrench in graph.wrenches} == {(0.0, 0.0, 0.0)}

    def touched():
        return [wrench for wrench in graph.wrenches if any(force(wrench))]

    ended_s = time.time()
    until(graph, [second], touched, "the other's contact")
    assert "another publisher" in estimator.log
    first_stamp = touched()[0].header.stamp
    # stale_after_s, and the wait of 0.6 s
    assert first_stamp.sec + first_stamp.nanosec * 1e-9 > ended_s + 0.7
    assert force(touched()[-1])[1] > 59.0
