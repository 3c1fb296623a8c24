"""A history-dependent estimator beside the sim over the real middleware: it answers in motion.

The machine may be busy: a move counts only where the sim kept to real time and no sample came too
late. The same motion in simulated time: tests/online/test_estimation.py.
"""

import numpy as np
import pytest
from ros_graph import Graph, NodeProcess, force
from sensor_msgs.msg import JointState

from cablesense_sim.arm import open_arm

rclpy = pytest.importorskip("rclpy")


pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

ARM = open_arm("cdsm")
AWAY, BACK = np.deg2rad([6.0, -4.0, 5.0, 3.0, -6.0, 4.0, -3.0, 5.0]), np.zeros(8)
_MOST_MOVES = 16


@pytest.fixture(scope="module")
def moving():
    """The graph, with both nodes running and the first tare taken."""
    graph = Graph()
    sim = NodeProcess("cablesense_ros.sim_node")
    estimator = NodeProcess("cablesense_ros.estimator_node", model="cdsm_moving")
    graph.until(lambda: "tare taken" in estimator.log, "the first tare")
    graph.until(lambda: graph.command.get_subscription_count() == 2, "sim and estimator")
    yield graph
    for process in (sim, estimator):
        assert process.stop() == 0, process.log
        assert "Traceback" not in process.log
    graph.close()


def _held_up(graph):
    """What a busy machine adds to: simulated time that was skipped, samples refused as too old."""
    graph.statuses.clear()
    wanted = {"sim: simulation": "time let go (s)", "estimator: cable_tensions": "refused in all"}
    graph.until(lambda: set(wanted) <= set(graph.statuses), "diagnostics")
    return [
        {value.key: value.value for value in graph.statuses[name].values}[key]
        for name, key in wanted.items()
    ]


def _swing(graph):
    """The wrenches received during four moves to and fro that the machine did not disturb."""
    received, kept = [], 0
    before = _held_up(graph)
    for move in range(_MOST_MOVES):
        graph.wrenches.clear()
        target = BACK if move % 2 else AWAY
        graph.command.publish(JointState(name=list(ARM.joint_names), position=target.tolist()))
        graph.spin(1.0)
        wrenches, after = list(graph.wrenches), _held_up(graph)
        if after == before:
            received, kept = received + wrenches, kept + 1
        if kept == 4:
            return received
        before = after
    pytest.skip(f"of {_MOST_MOVES} moves {kept} kept to real time: the machine is too busy")


def _strength_n(wrench):
    return float(np.linalg.norm(force(wrench)))


def test_a_free_arm_in_motion_has_no_contact(moving):
    received = [_strength_n(wrench) for wrench in _swing(moving)]
    assert len(received) > 200
    assert np.mean(np.array(received) == 0.0) > 0.9
    assert np.mean(received) < 0.1


def test_a_push_is_estimated_in_motion(moving):
    moving.push(4, (0.0, 0.0, -25.0))
    moving.spin(0.5)
    received = _swing(moving)
    moving.push(4, (0.0, 0.0, 0.0))
    assert np.mean([wrench.header.frame_id == "segment_4" for wrench in received]) > 0.95
    strength = np.array([_strength_n(wrench) for wrench in received])
    # gravity's direction turns against the segment's normal plane by up to 20 degrees
    assert np.quantile(strength, 0.05) > 21.0
    assert np.quantile(strength, 0.95) < 27.0
