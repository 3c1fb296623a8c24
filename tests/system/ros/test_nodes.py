"""The sim and estimator nodes as processes, over the real middleware."""

import math
from dataclasses import replace

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped, WrenchStamped
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from cablesense_msgs_py.messages import ForceState
from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from tests.helpers.ros_graph import force

ARM = open_arm("cdsm")
UNLOADED = solve_equilibrium(mechanism_of(ARM), np.zeros(8)).tensions_n


@pytest.fixture(scope="module")
def estimator(start_for_all):
    return start_for_all("estimator", tare_samples=20)


@pytest.fixture(scope="module")
def sim(start_for_all):
    best_effort = {"qos_overrides./cable_tensions.publisher.reliability": "best_effort"}
    return start_for_all("sim", **best_effort)


@pytest.fixture
def tared(graph, sim, estimator):
    """The arm at rest in its first pose, and nothing touches it, whatever a test before left."""
    graph.until(lambda: "tare taken" in estimator.log, "the first tare")
    if sim.alive:
        graph.release()
        graph.command.publish(command_at(0.0))
        graph.until(lambda: graph.tensions and off_n(graph, UNLOADED) < 0.5, "the arm at rest")
        graph.wrenches.clear()
        graph.until(touched(graph, 0), "an untouched arm")
    yield graph
    graph.forget()


def command_at(angle_rad):
    """All joints at one angle."""
    return JointState(name=list(ARM.joint_names), position=[angle_rad] * 8)


def off_n(graph, expected_n):
    """How far the latest tensions are from these, on average over 40 samples."""
    readings = np.array([message.effort for message in graph.tensions[-40:]])
    return np.abs(readings.mean(axis=0) - expected_n).max()


def touched(graph, segment=3):
    """Whether a contact on a segment is told; on segment 0, that nothing touches."""
    if segment == 0:
        return lambda: told(graph, ForceState.FREE) is not None
    return lambda: (
        bool(graph.wrenches) and graph.wrenches[-1].header.frame_id == f"segment_{segment}"
    )


def told(graph, state=None):
    """The force of the latest wrench but one, in this state; its state comes just after it."""
    if len(graph.wrenches) < 2:
        return None
    latest = graph.wrenches[-2]
    return force(latest) if state in (None, graph.state_of(latest)) else None


def told_state(graph):
    """The state of the latest wrench but one."""
    return graph.state_of(graph.wrenches[-2]) if len(graph.wrenches) > 1 else None


def test_a_push_is_estimated_in_every_form_and_its_end_as_well(tared):
    ends = [tared.listen(WrenchStamped, f"/estimator/wrench_{end}") for end in ("lower", "upper")]
    base = tared.listen(WrenchStamped, "/estimator/wrench_base")
    torques = tared.listen(JointState, "/estimator/joint_torques")
    poses = tared.listen(PoseWithCovarianceStamped, "/estimator/contact_pose")
    covariances = tared.listen(Float64MultiArray, "/estimator/contact_covariance")
    shown = tared.listen(MarkerArray, "/estimator/markers")
    pushed_n = (0.0, 40.0, 0.0)
    tared.push(3, pushed_n)
    tared.until(
        lambda: np.allclose(told(tared, ForceState.CONTACT) or math.nan, pushed_n, atol=1.0),
        "the push",
    )
    # while the arm still gives way to the push, the inertia of the last segment loads its joints
    tared.until(
        lambda: torques and max(torques[-1].effort) > 12.0 and not any(torques[-1].effort[6:]),
        "torques of the joints before the contact, and none beyond it",
    )
    tared.until(lambda: np.allclose(force(base[-1]), pushed_n, atol=1.0), "it in base axes")
    assert base[-1].header.frame_id == "base_link"
    x_m = kinematics.contact_points_m(mechanism_of(ARM), np.zeros(8))[2, 0]
    assert base[-1].wrench.torque.z == pytest.approx(40.0 * x_m, abs=1.0)
    tared.until(lambda: poses and covariances, "the point of the contact")
    assert poses[-1].header.frame_id == "base_link"
    assert poses[-1].pose.pose.position.x == pytest.approx(x_m, abs=2e-3)
    assert 0.0 < poses[-1].pose.covariance[0] < 0.015**2
    covariance = np.reshape(covariances[-1].data, (4, 4))
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert 0.0 < covariance[0, 0] < 0.015**2
    assert covariance[1, 1] > 5.0 > 1.0 > covariance[2, 2]  # a straight arm shows no axial force
    tared.until(lambda: shown and shown[-1].markers[-1].action == Marker.ADD, "the band")
    band = shown[-1].markers[-1]
    assert band.header.frame_id == "segment_3"
    assert band.pose.position.x == pytest.approx(0.065, abs=2e-3)
    turned = dict(zip(torques[-1].name, torques[-1].effort, strict=True))
    assert turned["joint_1_yaw"] == pytest.approx(40.0 * (2 * 0.13 + 0.065), abs=1.0)
    (touch,) = [w for w in tared.wrenches[-50:] if w.header.frame_id == "segment_3"][-1:]
    assert touch.wrench.torque.z == pytest.approx(0.065 * 40.0, abs=0.1)
    tared.push(3, (0.0, 0.0, 0.0))
    tared.until(lambda: told(tared, ForceState.FREE) == (0.0, 0.0, 0.0), "the contact to end")
    tared.until(lambda: not any(torques[-1].effort), "the torques to end")
    lower, force_n, upper = (
        {Time.from_msg(m.header.stamp).nanoseconds: np.linalg.norm(force(m)) for m in messages}
        for messages in (ends[0], tared.wrenches, ends[1])
    )
    stamps = set(lower) & set(force_n) & set(upper)
    assert max(force_n[stamp] for stamp in stamps) > 39.0
    assert all(lower[stamp] <= force_n[stamp] <= upper[stamp] for stamp in stamps)


def test_a_load_about_the_base_is_stated_as_the_estimator_states_it(tared):
    stated = tared.listen(WrenchStamped, "/estimator/wrench_base")
    load = WrenchStamped()
    load.header.frame_id = "base_link"
    load.wrench.force.y = 40.0
    load.wrench.torque.z = 40.0 * (0.015 + 2 * 0.13 + 0.065)
    tared.load.publish(load)
    tared.until(
        lambda: stated and abs(stated[-1].wrench.force.y - 40.0) < 0.5, "the force in base axes"
    )
    assert stated[-1].header.frame_id == "base_link"
    assert stated[-1].wrench.torque.z == pytest.approx(load.wrench.torque.z, abs=0.3)


def test_a_load_beside_the_contact_point_turns_the_arm_as_one_there(tared):
    load = WrenchStamped()
    load.header.frame_id = "base_link"
    load.wrench.force.y = 40.0
    load.wrench.torque.z = 40.0 * (0.015 + 2 * 0.13 + 0.11)
    tared.load.publish(load)
    mechanism = mechanism_of(ARM)
    forces_n = np.zeros((4, 3))
    forces_n[2, 1] = 40.0
    there = replace(mechanism, contact_m=np.full(4, 0.11))
    expected_n = solve_equilibrium(there, np.zeros(8), forces_n).tensions_n
    usual_n = solve_equilibrium(mechanism, np.zeros(8), forces_n).tensions_n
    assert np.abs(expected_n - usual_n).max() > 20.0
    tared.until(lambda: off_n(tared, expected_n) < 0.1, "tensions of an arm pushed there")
    tared.until(
        lambda: "segment_3: 40.0 at 0.110 m" in str(tared.statuses.get("sim: simulation")),
        "the place in diagnostics",
    )


def test_two_pushes_at_once_are_never_vouched_for_as_one(tared):
    """Nor for none."""
    for segment, push in ((2, (0.0, 0.0, 30.0)), (4, (0.0, -25.0, 0.0))):
        tared.push(segment, push)
    doubtful = (ForceState.UNCONFIRMED, ForceState.IMPLAUSIBLE)
    tared.until(lambda: told_state(tared) in doubtful, "doubt")
    tared.spin(1.0)  # the arm has settled
    tared.wrenches.clear()
    tared.until(lambda: len(tared.wrenches) > 50, "wrenches at rest")
    states = {tared.state_of(wrench) for wrench in tared.wrenches[:-5]}
    assert states & set(doubtful)
    assert not any(state is not None and state.known for state in states)
    tared.push(2, (0.0, 0.0, 0.0))
    tared.until(lambda: told(tared, ForceState.CONTACT) is not None, "the one that is left")


def test_a_tare_is_answered_with_its_values_and_can_be_taken_back(tared, estimator):
    tared.until(lambda: "estimator: tare" in tared.statuses, "diagnostics")
    tared.until(lambda: "tared since" in _values(tared, "tare"), "the first tare in diagnostics")
    before = _values(tared, "tare")["tared since"]
    taken = tared.call("/estimator/tare")
    assert taken.success
    assert "tare taken on request" in taken.message
    assert "cable_12" in taken.message
    undone = tared.call("/estimator/tare_undo")
    assert undone.success
    assert before in undone.message
    assert undone.message in estimator.log
    tared.until(
        lambda: _values(tared, "tare")["tares that can be undone"] == "1", "the first tare again"
    )
    assert _values(tared, "tare")["tared since"] == before


def test_a_load_that_is_none_is_refused_and_the_sim_goes_on(tared, sim):
    tared.push(9, (0.0, 40.0, 0.0))
    tared.push(2, (0.0, math.nan, 0.0))
    tared.until(
        lambda: "segment_1, segment_2, segment_3, segment_4" in sim.log, "the refusal in the log"
    )
    count = len(tared.tensions)
    tared.until(lambda: len(tared.tensions) > count + 20, "tensions to go on")
    tared.until(lambda: tared.wrenches, "wrenches to go on")
    assert force(tared.wrenches[-1]) == (0.0, 0.0, 0.0)


def test_a_command_moves_the_arm_without_a_false_force(tared):
    tared.until(lambda: tared.command.get_subscription_count() == 2, "sim and estimator")
    tared.wrenches.clear()
    tared.command.publish(command_at(0.05))
    tared.until(lambda: len(tared.wrenches) > 150, "wrenches while the arm moves")
    moved = solve_equilibrium(mechanism_of(ARM), np.full(8, 0.05)).tensions_n
    tared.until(lambda: np.abs(tared.tensions[-1].effort - moved).max() < 0.5, "the new pose")
    # a sample in thousands of an untouched arm that rests is a contact that is noise
    sizes_n = [np.linalg.norm(force(wrench)) for wrench in tared.wrenches]
    assert np.percentile(sizes_n, 99) < 0.5
    assert max(sizes_n) < 2.0
    assert ForceState.MOVING in map(tared.state_of, tared.wrenches)
    tared.push(2, (0.0, 0.0, 30.0))
    tared.until(touched(tared, 2), "a contact at the new pose")


def test_a_trajectory_is_followed_and_its_end_is_a_command(tared):
    angles = tared.listen(JointState, "/joint_states")
    out = tared.node.create_publisher(JointTrajectory, "/joint_trajectory", 10)
    tared.until(lambda: out.get_subscription_count() == 2, "sim and estimator")
    tared.until(lambda: angles, "joint states")
    for goal in (0.03, 0.0):
        point = JointTrajectoryPoint(positions=[7.0, goal])
        point.time_from_start.sec = 2
        message = JointTrajectory(joint_names=["gripper", "joint_2_yaw"], points=[point])
        out.publish(message)
        tared.until(
            lambda goal=goal: abs(angles[-1].position[3] - goal) < 1e-3, "the arm to arrive"
        )
    tared.until(
        lambda: _values(tared, "joint_commands")["command (deg)"] == ", ".join(["0.00"] * 8),
        "the estimator to know",
    )
    seen = [state.position[3] for state in angles]
    assert any(0.01 < angle < 0.02 for angle in seen)
    tared.node.destroy_publisher(out)


def test_a_tare_under_load_is_refused_and_where_forced_can_be_undone(tared):
    tared.push(4, (0.0, 0.0, -20.0))
    tared.until(touched(tared, 4), "a contact on segment 4")
    tared.spin(0.5)
    refused = tared.call("/estimator/tare")
    assert not refused.success
    assert "not those of the untouched arm" in refused.message
    assert "is read when the node is configured" in _refusal(tared, "tare_samples", 7)
    assert not _refusal(tared, "tare_force", True)
    answer = tared.call("/estimator/tare")
    assert answer.success, answer.message
    tared.until(
        lambda: "do not fit the tolerances" in tared.statuses["estimator: tare"].message,
        "diagnostics to say that no arm of these tolerances reads so without a load",
    )
    assert tared.call("/estimator/tare_undo").success
    assert not _refusal(tared, "tare_force", False)
    tared.until(touched(tared, 4), "the load to show again")


def test_description_diagnostics_and_overridden_quality_of_service(tared):
    tared.until(lambda: tared.descriptions, "the robot description")
    assert "<robot" in tared.descriptions[-1].data
    wanted = {f"estimator: {n}" for n in ("model", "cable_tensions", "cables", "tare")}
    wanted |= {"estimator: joint_commands", "sim: simulation"}
    tared.until(lambda: wanted <= set(tared.statuses), "all statuses")
    assert tared.statuses["estimator: model"].hardware_id == ARM.identity
    assert tared.statuses["sim: simulation"].message.startswith("at ")
    (info,) = tared.node.get_publishers_info_by_topic("/cable_tensions")
    assert info.qos_profile.reliability == qos_profile_sensor_data.reliability


def test_bad_samples_and_silence_give_zero_wrenches_and_diagnostics(tared, sim, estimator):
    assert sim.stop() == 0
    tared.until(lambda: "no sample for" in estimator.log, "silence to be noticed")
    tared.spin(0.5)  # an earlier silence may stand in the log; the last answers are under way
    tared.wrenches.clear()
    tared.until(lambda: len(tared.wrenches) > 5, "zero wrenches in the silence")
    tared.until(lambda: ForceState.SILENT in tared.states.values(), "the state in the silence")
    source = tared.node.create_publisher(JointState, "/cable_tensions", 10)
    tared.until(lambda: source.get_subscription_count() == 2, "estimator and test")
    tared.spin(0.5)  # that they know of the publisher as well
    nan = [*UNLOADED[:4], math.nan, *UNLOADED[5:]]
    names = list(ARM.cable_names)
    pushed = (UNLOADED + np.linspace(-20.0, 20.0, 12)).tolist()

    def publish(name, effort):
        message = JointState(name=name, effort=effort)
        message.header.stamp = tared.node.get_clock().now().to_msg()
        source.publish(message)

    for name, effort in ((names, nan), (names[:9], pushed[:9])):  # two kinds at the same moment
        publish(name, effort)
    tared.until(
        lambda: "cable_5 is nan N" in estimator.log and "missing 'cable_10'" in estimator.log,
        "both refusals in the log",
    )
    tared.spin(1.1)  # the next of a kind is logged a second later
    publish(["x"] * 12, pushed)
    tared.until(lambda: "more than once" in estimator.log, "the third refusal in the log")
    assert max(np.linalg.norm(force(wrench)) for wrench in tared.wrenches) < 0.5
    tared.until(
        lambda: int(_values(tared, "cable_tensions")["refused in all"]) >= 3, "the diagnostics"
    )
    assert ForceState.REFUSED in tared.states.values()
    publish(names[::-1], UNLOADED[::-1].tolist())
    tared.spin(0.2)
    assert estimator.alive
    tared.node.destroy_publisher(source)


def _refusal(graph, name, value):
    """Why the estimator does not take a parameter; empty where it does."""
    client = graph.node.create_client(SetParameters, "/estimator/set_parameters")
    graph.until(client.service_is_ready, "the estimator's parameters")
    parameter = Parameter(name, value=value).to_parameter_msg()
    future = client.call_async(SetParameters.Request(parameters=[parameter]))
    graph.until(future.done, "the new value")
    graph.node.destroy_client(client)
    result = future.result().results[0]
    return "" if result.successful else result.reason


def _values(graph, status):
    return {v.key: v.value for v in graph.statuses[f"estimator: {status}"].values}
