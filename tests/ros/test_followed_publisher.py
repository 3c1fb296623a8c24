"""Two publishers of tensions beside one estimator, and a state file that cannot be written."""

import time

import numpy as np
import pytest
from ros_graph import Graph, NodeProcess, force
from sensor_msgs.msg import JointState

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium

rclpy = pytest.importorskip("rclpy")

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

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


def test_one_is_used_until_it_ends_then_the_other_after_a_wait(graph, tmp_path):
    folder = tmp_path / "states"
    folder.mkdir()
    estimator = NodeProcess("cablesense_ros.estimator_node", state_file=folder / "state.json")
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
    until(graph, both, lambda: len(graph.wrenches) > 150, "wrenches")
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

    folder.rename(tmp_path / "away")
    until(graph, [second], lambda: level("state file")[0] == 2, "an error")
    assert "cannot be written" in level("state file")[1] or "No such" in level("state file")[1]
    folder.mkdir()
    until(graph, [second], lambda: level("state file")[0] == 0, "the state to be kept again")
    assert (folder / "state.json").exists()
    assert estimator.stop() == 0, estimator.log
