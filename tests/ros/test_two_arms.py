"""Two arms side by side, each in its namespace: neither sees, or is mistaken for, the other."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from ros_graph import NodeProcess, force

from cablesense_msgs_py.messages import ForceState, Level, read_force_state

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

ARMS = ("left", "right")


@pytest.fixture(scope="module")
def nodes():
    started = {
        (name, arm): NodeProcess(
            f"cablesense_ros.{name}_node", f"/{arm}", frame_prefix=f"{arm}_", **parameters
        )
        for arm in ARMS
        for name, parameters in (("sim", {}), ("estimator", {"tare_samples": 20}))
    }
    yield started
    for process in started.values():
        assert process.stop() in (0, -9), process.log


def test_a_push_and_a_death_of_one_arm_are_of_that_arm_alone(graph, nodes):
    wrenches, states = (
        {arm: graph.listen(kind, f"/{arm}/estimator/{topic}") for arm in ARMS}
        for kind, topic in ((WrenchStamped, "wrench"), (DiagnosticArray, "status"))
    )
    for arm in ARMS:
        log = nodes["estimator", arm]
        graph.until(lambda log=log: "tare taken" in log.log, f"the tare of the {arm} arm")
    push = graph.node.create_publisher(WrenchStamped, "/left/applied_wrench", 10)
    graph.until(push.get_subscription_count, "the left sim")
    load = WrenchStamped()
    load.header.frame_id, load.wrench.force.y = "left_segment_3", 40.0
    push.publish(load)
    graph.until(
        lambda: wrenches["left"] and wrenches["left"][-1].header.frame_id == "left_segment_3",
        "the contact of the left arm",
    )
    seen = len(wrenches["right"])
    graph.until(lambda: len(wrenches["right"]) > seen + 20, "the right arm meanwhile")
    assert {wrench.header.frame_id for wrench in wrenches["right"]} >= {"right_base_link"}
    # one sample in a thousand tells a contact of some tenths of a newton that is noise
    assert max(np.linalg.norm(force(wrench)) for wrench in wrenches["right"]) < 1.0

    named = {arm: f"{arm}/estimator: cable_tensions" for arm in ARMS}
    graph.until(lambda: set(named.values()) <= set(graph.statuses), "diagnostics of both")
    assert not any(name.startswith(("sim", "estimator")) for name in graph.statuses)
    assert {graph.statuses[named[arm]].hardware_id.split("/")[0] for arm in ARMS} == set(ARMS)

    nodes["sim", "right"].kill()
    graph.until(
        lambda: graph.statuses[named["right"]].level == bytes([Level.STALE]), "the right to end"
    )
    graph.until(
        lambda: read_force_state(states["right"][-1])[0] is ForceState.SILENT, "the right's state"
    )
    assert graph.statuses[named["left"]].level != bytes([Level.STALE])
    assert wrenches["left"][-1].header.frame_id == "left_segment_3"
