"""A history-dependent estimator beside the sim over the real middleware: it answers in motion.

How right it is in motion is judged in simulated time: tests/online/test_estimation.py.
"""

import time

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from ros_graph import Graph, NodeProcess, force
from sensor_msgs.msg import JointState

from cablesense_msgs_py.messages import ForceState
from cablesense_sim.arm import open_arm

rclpy = pytest.importorskip("rclpy")


pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

JOINT_NAMES = list(open_arm("cdsm").joint_names)
AWAY = np.deg2rad([6.0, -4.0, 5.0, 3.0, -6.0, 4.0, -3.0, 5.0])
TURN_EVERY_S = 0.2
"""A move takes longer, and the arm 0.5 s more to settle: it never rests between commands."""


def test_a_push_is_estimated_in_motion():
    graph = Graph()
    nodes = [
        NodeProcess("cablesense_ros.sim_node"),
        NodeProcess("cablesense_ros.estimator_node", model="cdsm_moving"),
    ]
    graph.until(lambda: "tare taken" in nodes[1].log, "the first tare")
    graph.until(lambda: graph.command.get_subscription_count() == 2, "sim and estimator")
    target, turned_s = np.zeros(8), time.monotonic()

    def turn():
        nonlocal target, turned_s
        if time.monotonic() - turned_s > TURN_EVERY_S:
            target, turned_s = AWAY - target, time.monotonic()
            message = JointState(name=JOINT_NAMES, position=target.tolist())
            graph.command.publish(message)

    def found():
        turn()
        # gravity's direction turns against the segment's normal plane by up to 20 degrees
        pushed = [w for w in graph.wrenches if w.header.frame_id == "segment_4"]
        return sum(21.0 < np.linalg.norm(force(wrench)) < 27.0 for wrench in pushed) > 100

    def in_motion():
        turn()
        return target.any()

    # confirms the pose that the tare assumes; else a first command elsewhere would drop it
    graph.command.publish(JointState(name=JOINT_NAMES, position=target.tolist()))
    graph.push(4, (0.0, 0.0, -25.0))
    graph.until(in_motion, "a move")
    graph.wrenches.clear()
    graph.until(found, "the push in motion")
    for process in nodes:
        assert process.stop() == 0, process.log
        assert "Traceback" not in process.log
    graph.close()


def test_under_friction_it_says_what_may_act_unseen():
    graph = Graph()
    nodes = [
        NodeProcess(f"cablesense_ros.{name}", arm="cdsm_friction")
        for name in ("sim_node", "estimator_node")
    ]
    graph.until(lambda: "tare taken" in nodes[1].log, "the tare")
    graph.states.clear()  # the sim may have been the later one to start
    upper = graph.listen(WrenchStamped, "/estimator/wrench_upper")
    hidden = ForceState.HIDDEN
    graph.until(lambda: len(upper) > 50 and hidden in graph.states.values(), "what may act")
    answers = {ForceState.UNTARED, ForceState.FREE, hidden}  # the first may still be on its way
    assert set(graph.states.values()) <= answers
    assert max(np.linalg.norm(force(wrench)) for wrench in upper) > 1.0
    assert {force(wrench) for wrench in graph.wrenches} == {(0.0, 0.0, 0.0)}
    graph.push(3, (0.0, 60.0, 0.0))
    graph.until(lambda: ForceState.CONTACT in graph.states.values(), "a contact")
    graph.spin(0.3)
    assert graph.wrenches[-1].header.frame_id == upper[-1].header.frame_id == "segment_3"
    assert np.linalg.norm(force(upper[-1])) > 50.0
    codes = [node.stop() for node in nodes]
    graph.close()
    assert codes == [0, 0], [node.log for node in nodes]


def test_a_push_under_friction_is_known_as_it_falls():
    graph = Graph()
    settings = {"arm": "cdsm_friction"}
    nodes = [
        NodeProcess("cablesense_ros.sim_node", **settings),
        NodeProcess("cablesense_ros.estimator_node", model="cdsm_friction_simulated", **settings),
    ]
    graph.until(lambda: "tare taken" in nodes[1].log, "the tare")
    for size_n in (60.0, 20.0):
        graph.push(3, (0.0, size_n, 0.0))

        def known(pushed_n: float = size_n) -> bool:
            found = [w for w in graph.wrenches[-5:] if w.header.frame_id == "segment_3"]
            sizes = [np.linalg.norm(force(wrench)) for wrench in found]
            return len(sizes) == 5 and all(abs(size - pushed_n) < 2.0 for size in sizes)

        graph.until(known, f"{size_n} N")
    graph.push(3, (0.0, 0.0, 0.0))
    graph.until(
        lambda: not any(any(force(wrench)) for wrench in graph.wrenches[-5:]), "the release"
    )
    codes = [node.stop() for node in nodes]
    graph.close()
    assert codes == [0, 0], [node.log for node in nodes]
