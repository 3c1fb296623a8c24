"""Arms of several kinds over the real middleware: with effects, with friction, and two at once.

How right a history-dependent estimator is in motion is judged in simulated time:
tests/physics/online/test_estimation.py.
"""

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import WrenchStamped

from cablesense_msgs_py.messages import ForceState, Level
from cablesense_sim.course import Course
from cablesense_sim.replay import replay_arm
from tests.helpers.arm_variants import variant
from tests.helpers.ros_graph import Graph, force

OFFSET = {"effect": "sensor_offset", "at": "cable_9", "parameters": {"offset_n": 7.0}}
PAYLOAD = {"effect": "payload", "at": "segment_4", "parameters": {"mass_kg": 0.4}}
FRICTION = {"effect": "joint_friction", "at": "joint_2", "parameters": {"torque_n_m": 0.2}}
ARMS = ("left", "right")


@pytest.fixture
def graph():
    talking = Graph()
    yield talking
    talking.close()


def test_an_amended_arm_is_published_as_the_replay_has_it(graph, start, tmp_path):
    listed = [OFFSET, PAYLOAD, FRICTION]
    arm = variant({"effects": listed, "sensors.rate_hz": 50}, "cdsm_lab")
    path = tmp_path / "amended.yaml"
    path.write_text(yaml.safe_dump(arm.model_dump()), encoding="utf-8")
    loads = np.zeros((2, 4, 3))
    loads[1, 2] = [0.0, 12.0, 0.0]
    expected = replay_arm(arm, Course(np.array([0.0, 1.0]), np.zeros((2, 8)), loads))
    start("sim", arm=path, noise=False)
    graph.until(lambda: len(graph.tensions) > 10, "tensions")
    np.testing.assert_allclose(graph.tensions[-1].effort, expected[0], atol=1e-3)
    graph.push(3, loads[1, 2])
    graph.until(
        lambda: np.abs(graph.tensions[-1].effort - expected[1]).max() < 1e-3,
        "the tensions of the replay under load",
    )
    graph.until(lambda: "sim: simulation" in graph.statuses, "diagnostics")
    assert graph.statuses["sim: simulation"].hardware_id == arm.identity


def test_under_friction_it_says_what_may_act_unseen(graph, start):
    start("sim", arm="cdsm_friction")
    estimator = start("estimator", arm="cdsm_friction")
    graph.until(lambda: "configured" in estimator.log, "the estimator")  # friction is compiled
    graph.until(lambda: "tare taken" in estimator.log, "the tare")
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
    graph.until(lambda: np.linalg.norm(force(upper[-1])) > 50.0, "its upper end")
    assert graph.wrenches[-1].header.frame_id == upper[-1].header.frame_id == "segment_3"


def test_a_push_and_a_death_of_one_arm_are_of_that_arm_alone(graph, start):
    nodes = {
        (name, arm): start(name, f"/{arm}", frame_prefix=f"{arm}_")
        for arm in ARMS
        for name in ("sim", "estimator")
    }
    wrenches = {arm: graph.listen(WrenchStamped, f"/{arm}/estimator/wrench") for arm in ARMS}
    for arm in ARMS:
        log = nodes["estimator", arm]
        graph.until(lambda log=log: "tare taken" in log.log, f"the tare of the {arm} arm")
    push = graph.node.create_publisher(WrenchStamped, "/left/applied_wrench", 10)
    graph.until(push.get_subscription_count, "the left sim")
    load = WrenchStamped()
    load.header.frame_id = "left_segment_3"
    load.wrench.force.y = 40.0
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
    assert {graph.statuses[named[arm]].hardware_id.split("/")[0] for arm in ARMS} == set(ARMS)
    nodes["sim", "right"].kill()
    stale = bytes([Level.STALE])
    graph.until(lambda: graph.statuses[named["right"]].level == stale, "the right to end")
    assert graph.statuses[named["left"]].level != stale
    assert wrenches["left"][-1].header.frame_id == "left_segment_3"
