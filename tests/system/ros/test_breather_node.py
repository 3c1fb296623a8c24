"""An arm with friction that breathes, with real nodes: forces as if there were no friction."""

import signal
from functools import partial

import numpy as np
import pytest
from sensor_msgs.msg import JointState

from cablesense_sim.arm import open_arm
from tests.helpers.ros_graph import force

TOLD = {"estimator: tare", "estimator: breathing"}


@pytest.fixture
def arm(graph, start):
    """Sim and estimator."""
    arm = {"arm": "cdsm_friction"}
    sim = start("sim", **arm, seed=1)
    return sim, start("estimator", **arm, await_breath=True, stale_after_s=1.0)


def status(graph, name):
    shown = graph.statuses.get(name)
    return shown.message if shown else ""


def breaths(graph):
    shown = graph.statuses.get("breather: breathing")
    return shown and {value.key: value.value for value in shown.values}["breaths"]


def further(graph, before):
    return breaths(graph) not in (None, before)


def breathe_until(graph, right, what):
    """Breathe again and again: a machine that is busy may lose samples of a breath."""
    for _ in range(6):
        graph.until(lambda: breaths(graph), "the breather's diagnostics")
        before = breaths(graph)
        answer = graph.call("/breather/breathe")
        assert answer.success, answer.message
        graph.until(partial(further, graph, before), "a breath")
        graph.statuses.clear()
        graph.wrenches.clear()
        graph.until(lambda: len(graph.wrenches) > 20 and set(graph.statuses) >= TOLD, "estimates")
        if right():
            return
    pytest.fail(f"no breath after which there is {what}")


@pytest.mark.timeout(300)
def test_after_a_breath_forces_are_those_without_friction_and_a_killed_breather_is_missed(
    graph, arm, start
):
    sim, estimator = arm
    breath = {"arm": "cdsm_friction", "over": "cable_offsets", "await_command": False}
    breather = start("breather", **breath, rest_s=0.0, turn_s=1.5)
    graph.until(lambda: len(graph.wrenches) > 10, "estimates")
    breathe_until(graph, lambda: "1 tare" in status(graph, "estimator: tare"), "a tare")
    pushed_n = (0.0, 30.0, -10.0)
    graph.push(3, pushed_n)
    graph.spin(1.0)

    def right():
        return np.abs(np.subtract(force(graph.wrenches[-1]), pushed_n)).max() < 0.6

    breathe_until(graph, right, f"{pushed_n} N")
    graph.until(lambda: "breathed" in status(graph, "estimator: breathing"), "the arm at rest")

    breather.signal(signal.SIGINT)
    assert breather.wait() == 0
    breather = start("breather", **breath, continuous=True, turn_s=1.5)
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
