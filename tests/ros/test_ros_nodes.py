"""The sim and estimator nodes as processes, over the real middleware."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from ros_graph import NodeProcess, force
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from cablesense_msgs_py.messages import ForceState
from cablesense_msgs_py.qos import CONTRACT
from cablesense_online.replay import RecordedRun, replay_in_process
from cablesense_ros.recorder import Recorder
from cablesense_sim import kinematics
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
UNLOADED = solve_equilibrium(mechanism_of(ARM), np.zeros(8)).tensions_n
SIM, ESTIMATOR = "cablesense_ros.sim_node", "cablesense_ros.estimator_node"


@pytest.fixture(scope="module")
def estimator():
    process = NodeProcess(ESTIMATOR, tare_samples=20)
    yield process
    assert process.stop() == 0, process.log
    assert "Traceback" not in process.log


@pytest.fixture(scope="module")
def sim():
    process = NodeProcess(
        SIM, **{"qos_overrides./cable_tensions.publisher.reliability": "best_effort"}
    )
    yield process
    assert process.stop() == 0, process.log
    assert "Traceback" not in process.log


@pytest.fixture(scope="module")
def tared(graph, sim, estimator):
    graph.until(lambda: "tare taken" in estimator.log, "the first tare")
    return graph


def touched(graph, segment=3):
    return lambda: (
        bool(graph.wrenches)
        and graph.wrenches[-1].header.frame_id
        == (f"segment_{segment}" if segment else "base_link")
    )


def test_a_push_of_40_n_is_estimated_and_its_end_as_well(tared):
    tared.push(3, (0.0, 40.0, 0.0))
    tared.until(touched(tared), "a contact on segment 3")
    tared.spin(0.5)
    assert np.linalg.norm(np.subtract(force(tared.wrenches[-1]), (0.0, 40.0, 0.0))) < 1.0
    torque = tared.wrenches[-1].wrench.torque
    assert torque.z == pytest.approx(0.065 * 40.0, abs=0.1)
    assert tared.state_of(tared.wrenches[-2]) is ForceState.CONTACT
    tared.push(3, (0.0, 0.0, 0.0))
    tared.until(touched(tared, 0), "the contact to end")
    tared.spin(0.3)
    assert force(tared.wrenches[-1]) == (0.0, 0.0, 0.0)
    assert tared.state_of(tared.wrenches[-2]) is ForceState.FREE


def test_a_load_about_the_base_is_stated_as_the_estimator_states_it(tared):
    stated = tared.listen(WrenchStamped, "/estimator/wrench_base")
    load = WrenchStamped()
    load.header.frame_id = "base_link"
    load.wrench.force.y, load.wrench.torque.z = 40.0, 40.0 * (0.015 + 2 * 0.13 + 0.065)
    tared.load.publish(load)
    tared.until(touched(tared), "a contact on segment 3")
    tared.spin(0.5)
    assert stated[-1].header.frame_id == "base_link"
    assert stated[-1].wrench.force.y == pytest.approx(load.wrench.force.y, abs=0.5)
    assert stated[-1].wrench.torque.z == pytest.approx(load.wrench.torque.z, abs=0.2)
    tared.push(3, (0.0, 0.0, 0.0))
    tared.until(touched(tared, 0), "the contact to end")


def test_every_wrench_lies_within_its_published_bounds(tared):
    ends = [tared.listen(WrenchStamped, f"/estimator/wrench_{end}") for end in ("lower", "upper")]
    tared.push(3, (0.0, 40.0, 0.0))
    tared.until(touched(tared), "a contact on segment 3")
    tared.spin(0.2)
    tared.push(3, (0.0, 0.0, 0.0))
    tared.until(touched(tared, 0), "the contact to end")
    tared.spin(0.3)
    lower, force_n, upper = (
        {Time.from_msg(m.header.stamp).nanoseconds: np.linalg.norm(force(m)) for m in messages}
        for messages in (ends[0], tared.wrenches, ends[1])
    )
    stamps = set(lower) & set(force_n) & set(upper)
    assert max(force_n[stamp] for stamp in stamps) > 39.0
    assert all(lower[stamp] <= force_n[stamp] <= upper[stamp] for stamp in stamps)


def test_the_force_comes_in_base_axes_and_at_the_joints_as_well(tared):
    base = tared.listen(WrenchStamped, "/estimator/wrench_base")
    torques = tared.listen(JointState, "/estimator/joint_torques")
    tared.push(3, (0.0, 40.0, 0.0))
    tared.until(touched(tared), "a contact on segment 3")
    tared.until(lambda: base and base[-1].wrench.force.y > 30.0, "the force in base axes")
    assert {wrench.header.frame_id for wrench in base} == {"base_link"}
    np.testing.assert_allclose(force(base[-1]), (0.0, 40.0, 0.0), atol=1.0)
    x_m = kinematics.contact_points_m(mechanism_of(ARM), np.zeros(8))[2, 0]
    assert base[-1].wrench.torque.z == pytest.approx(40.0 * x_m, abs=1.0)
    tared.until(lambda: torques and max(torques[-1].effort) > 5.0, "torques of the joints")
    turned = dict(zip(torques[-1].name, torques[-1].effort, strict=True))
    assert turned["joint_1_yaw"] == pytest.approx(40.0 * (2 * 0.13 + 0.065), abs=1.0)
    assert turned["joint_4_yaw"] == 0.0
    tared.push(3, (0.0, 0.0, 0.0))
    tared.until(lambda: not any(torques[-1].effort), "the torques to end")


def test_several_contacts_at_once_have_a_wrench_each_and_are_replayed(tared, tmp_path):
    remaps = {name: f"/{name}" for name in ("cable_tensions", "joint_commands")}
    args = [word for name, to in remaps.items() for word in ("-r", f"{name}:={to}")]
    listener = Node("recorder", namespace="/several", cli_args=["--ros-args", *args])
    tared.executor.add_node(listener)
    recorder = Recorder(listener, tmp_path / "several.mcap", CONTRACT, None, print)
    several = NodeProcess(ESTIMATOR, "/several", remaps, model="cdsm_multi")
    told = {
        number: tared.listen(WrenchStamped, f"/several/estimator/wrenches/segment_{number}")
        for number in (2, 3, 4)
    }
    shown = tared.listen(MarkerArray, "/several/estimator/markers")
    tared.until(lambda: "tare taken" in several.log, "its tare")
    for segment, push in ((2, (0.0, 0.0, 30.0)), (4, (0.0, -25.0, 0.0))):
        tared.push(segment, push)

    def both():
        return [force(told[number][-1])[k] for number, k in ((2, 2), (4, 1))]

    tared.until(lambda: all(told.values()), "wrenches of all segments")
    recorder.flush()  # subscribes to the segments, whose discovery takes a while
    tared.until(lambda: np.allclose(both(), (30.0, -25.0), atol=2.0), "both forces")
    tared.until(lambda: not any(force(told[3][-1])), "nothing on the segment between")
    tared.until(
        lambda: shown and [m.action for m in shown[-1].markers].count(Marker.ADD) == 4,
        "two arrows with their spheres",
    )
    for force_n in (30.0, 0.0):  # recorded from here on, with its journal from the start
        recorder.flush()
        tared.push(2, (0.0, 0.0, force_n))
        tared.spin(2.5)
    recorder.close()
    tared.executor.remove_node(listener)
    listener.destroy_node()
    run = RecordedRun(tmp_path / "several.mcap")
    assert run.segments == (1, 2, 3, 4)
    whole = [len(step.answers) == 5 for step in run.samples()]
    assert 50 < sum(whole) < len(whole)  # the recorder had to find the segments
    got = replay_in_process(run)
    assert got.same, got.first_difference
    other = replay_in_process(run, model="cdsm")
    assert "segment_" in other.first_difference
    tared.push(4, (0.0, 0.0, 0.0))
    for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
        assert tared.change_state("/several/estimator", transition)
    assert "UTC is forgotten; a state_file would keep it" in several.log
    assert several.stop() == 0
    tared.until(touched(tared, 0), "the contacts to end")


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
    tared.until(lambda: "segment_1 … segment_4" in sim.log, "the refusal in the log")
    count = len(tared.tensions)
    tared.until(lambda: len(tared.tensions) > count + 20, "tensions to go on")
    tared.until(lambda: tared.wrenches, "wrenches to go on")
    assert force(tared.wrenches[-1]) == (0.0, 0.0, 0.0)


def test_a_command_moves_the_arm_without_a_false_force(tared):
    tared.until(lambda: tared.command.get_subscription_count() == 2, "sim and estimator")
    tared.wrenches.clear()
    command = JointState(name=list(ARM.joint_names), position=[0.05] * 8)
    tared.command.publish(command)
    tared.until(lambda: len(tared.wrenches) > 150, "wrenches while the arm moves")
    moved = solve_equilibrium(mechanism_of(ARM), np.full(8, 0.05)).tensions_n
    tared.until(lambda: np.abs(tared.tensions[-1].effort - moved).max() < 0.5, "the new pose")
    # one sample in a thousand of an untouched arm that rests is a contact that is noise
    assert max(np.linalg.norm(force(wrench)) for wrench in tared.wrenches) < 0.5
    assert ForceState.MOVING in map(tared.state_of, tared.wrenches)
    tared.push(2, (0.0, 0.0, 30.0))
    tared.until(touched(tared, 2), "a contact at the new pose")
    tared.push(2, (0.0, 0.0, 0.0))
    tared.command.publish(JointState(name=list(ARM.joint_names), position=[0.0] * 8))
    tared.spin(1.5)


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


def test_a_stream_of_commands_that_hardly_differ_hides_no_contact(tared):
    rng = np.random.default_rng(0)

    def stream():
        angles = rng.normal(0.0, 1e-6, 8).tolist()
        tared.command.publish(JointState(name=list(ARM.joint_names), position=angles))

    streaming = tared.node.create_timer(0.01, stream)
    tared.push(3, (0.0, 30.0, 0.0))
    tared.until(touched(tared), "a contact on segment 3")
    tared.states.clear()

    def told(state):
        return list(tared.states.values()).count(state)

    tared.until(lambda: told(ForceState.CONTACT) > 50, "more of it")
    assert told(ForceState.MOVING) == 0
    tared.push(3, (0.0, 0.0, 0.0))
    tared.until(touched(tared, 0), "the contact to end")
    tared.node.destroy_timer(streaming)


def test_a_tare_under_load_is_refused_and_where_forced_can_be_undone(tared):
    tared.push(4, (0.0, 0.0, -20.0))
    tared.until(touched(tared, 4), "a contact on segment 4")
    tared.spin(0.5)
    refused = tared.call("/estimator/tare")
    assert not refused.success
    assert "N on segment 4 is reported" in refused.message
    assert "is read when the node is configured" in _refusal(tared, "tare_samples", 7)
    assert not _refusal(tared, "tare_force", True)
    answer = tared.call("/estimator/tare")
    assert answer.success, answer.message
    tared.until(touched(tared, 0), "the tared load to vanish")
    assert tared.call("/estimator/tare_undo").success
    assert not _refusal(tared, "tare_force", False)
    tared.until(touched(tared, 4), "the load to show again")
    tared.push(4, (0.0, 0.0, 0.0))
    tared.until(touched(tared, 0), "the contact to end")


def test_description_and_diagnostics(tared):
    tared.until(lambda: tared.descriptions, "the robot description")
    assert "<robot" in tared.descriptions[-1].data
    wanted = {f"estimator: {n}" for n in ("model", "cable_tensions", "cables", "tare")}
    wanted |= {"estimator: joint_commands", "sim: simulation"}
    tared.until(lambda: wanted <= set(tared.statuses), "all statuses")
    assert tared.statuses["estimator: model"].hardware_id == ARM.identity
    assert tared.statuses["sim: simulation"].message.startswith("at ")


def test_qos_overrides_reach_the_publisher(tared):
    (info,) = tared.node.get_publishers_info_by_topic("/cable_tensions")
    assert info.qos_profile.reliability == qos_profile_sensor_data.reliability


def test_bad_samples_and_silence_give_zero_wrenches_and_diagnostics(tared, sim, estimator):
    assert sim.stop() == 0
    tared.until(lambda: "no sample for" in estimator.log, "silence to be noticed")
    tared.wrenches.clear()
    tared.until(lambda: len(tared.wrenches) > 5, "zero wrenches in the silence")
    tared.until(lambda: ForceState.SILENT in tared.states.values(), "the state in the silence")
    source = tared.node.create_publisher(JointState, "/cable_tensions", 10)
    tared.until(lambda: source.get_subscription_count() == 2, "estimator and test")
    tared.spin(0.5)  # that they know of the publisher as well
    nan, names = [*UNLOADED[:4], math.nan, *UNLOADED[5:]], list(ARM.cable_names)
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
