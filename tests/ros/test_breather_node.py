"""An arm with friction that breathes, with real nodes: forces as if there were no friction."""

from functools import partial

import numpy as np
import pytest
from ros_graph import Graph, force
from sensor_msgs.msg import JointState

from cablesense_sim.arm import open_arm


@pytest.fixture
def graph():
    graph = Graph()
    yield graph
    graph.close()


@pytest.fixture(params=["joint_commands", "cable_offsets"])
def arm(request, graph, start):
    """Sim, estimator and breather, which have found each other."""
    arm = {"arm": "cdsm_friction"}
    start("sim", **arm, seed=1)
    start("estimator", **arm, model="cdsm", await_breath=True, stale_after_s=1.0)
    breath = {"over": request.param, "await_command": False, "rest_s": 0.0, "turn_s": 1.5}
    start("breather", **arm, **breath)


def status(graph, name):
    found = graph.statuses.get(name)
    return found.message if found else ""


def breaths(graph):
    found = graph.statuses.get("breather: breathing")
    return found and {value.key: value.value for value in found.values}["breaths"]


def further(graph, before):
    return breaths(graph) not in (None, before)


def breathed(graph):
    """The wrench after one breath; a machine that is busy may lose samples of one."""
    for _ in range(5):
        graph.until(lambda: breaths(graph), "the breather's diagnostics")
        before = breaths(graph)
        answer = graph.call("/breather/breathe")
        assert answer.success, answer.message
        graph.until(partial(further, graph, before), "a breath")
        graph.statuses.clear()
        graph.until(lambda: shown(graph), "what it shows")
        if "breathed" in shown(graph):
            break
    assert "breathed" in shown(graph)
    graph.wrenches.clear()
    graph.until(lambda: len(graph.wrenches) > 20, "estimates")
    return graph.wrenches[-1]


def shown(graph):
    message = status(graph, "estimator: breathing")
    return message if "breathed" in message or "samples" in message else ""


def test_after_a_breath_forces_are_those_without_friction(graph, arm):
    graph.until(lambda: len(graph.wrenches) > 10, "estimates")
    breathed(graph)
    graph.until(lambda: status(graph, "estimator: tare").startswith("tared"), "the tare")
    graph.push(3, (0.0, 30.0, -10.0))
    graph.spin(1.0)
    wrench = breathed(graph)
    assert wrench.header.frame_id == "segment_3"
    np.testing.assert_allclose(force(wrench), (0.0, 30.0, -10.0), atol=0.6)
    graph.push(3, (0.0, 0.0, 0.0))
    graph.spin(1.0)
    assert np.linalg.norm(force(breathed(graph))) < 0.5


def test_a_breather_that_is_killed_is_missed_and_wrong_offsets_are_refused(graph, start):
    sim, estimator = start("sim"), start("estimator")
    breath = {"amplitude_deg": 0.1, "await_command": False, "continuous": True, "turn_s": 1.5}
    breather = start("breather", **breath)
    graph.until(lambda: "breathing" in status(graph, "estimator: breathing"), "a breath")
    breather.kill()
    graph.until(lambda: "fell silent" in status(graph, "estimator: breathing"), "the report")
    graph.until(lambda: "fell silent" in estimator.log, "the warning")
    offsets = graph.node.create_publisher(JointState, "/cable_offsets", 10)
    graph.until(lambda: offsets.get_subscription_count() >= 2, "arm and estimator")
    names = list(open_arm("cdsm").cable_names)
    for wrong in ([float("nan")] * 12, [1.0] * 12, [0.0] * 3):
        offsets.publish(JointState(name=names, position=wrong))
    graph.until(lambda: "refused" in status(graph, "estimator: joint_commands"), "the refusal")
    graph.until(lambda: "offsets" in sim.log, "the arm's refusal")
