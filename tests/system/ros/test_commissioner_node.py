"""A commissioning with real nodes: to its end, and what stops it."""

import signal

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray

from cablesense_contact.calibration_file import calibration_of, described, read_calibration
from cablesense_contact.felt_arm import FeltArm
from cablesense_sim.arm import open_arm

STATUS = "commissioner: commissioning"


@pytest.fixture
def run(graph, start):
    """The simulated arm and a commissioner; gives what starts one in few poses."""
    start("sim", arm="cdsm_lab", rate_hz=100.0, seed=1)

    def commissioner(**parameters):
        given = {"poses": 4, "bend_deg": 5.0, "rest_s": 0.0, "await_command": False}
        return start("commissioner", arm="cdsm_lab", **given | parameters)

    return commissioner


def status(graph):
    status_message = graph.statuses.get(STATUS)
    return status_message.message if status_message else ""


def begin(graph):
    graph.until(lambda: graph.tensions, "tensions")
    graph.until(lambda: status(graph), "the commissioner's diagnostics")
    answer = graph.call("/commissioner/commission")
    assert answer.success, answer.message
    return answer.message


def commands_of(graph):
    return graph.listen(JointState, "/joint_commands")


@pytest.mark.timeout(300)
def test_a_commissioning_ends_in_a_calibration_that_is_saved_and_published(graph, run, tmp_path):
    file = tmp_path / "lab.calibration"
    run(calibration_file=str(file))
    received = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    text = begin(graph)
    assert text.startswith("4 holds in 4 poses, about ")
    assert "leave it alone" in text
    refused = graph.call("/commissioner/commission")
    assert not refused.success
    assert "under way" in refused.message
    commands = commands_of(graph)
    graph.until(lambda: "holds" in status(graph) and "is known to" in status(graph), "progress")
    graph.until(lambda: status(graph).startswith("done"), "the end")
    assert status(graph) == "done: a commissioning in 4 poses"
    assert np.abs(commands[-1].position).max() == 0.0  # back where it began
    # a late subscriber gets it too
    graph.node.create_subscription(UInt8MultiArray, "/calibration", received.append, latched)
    graph.until(lambda: received, "the calibration")
    arm = open_arm("cdsm_lab")
    content = bytes(received[0].data)
    calibration = calibration_of(content, FeltArm(arm), "calibration")
    assert described(content, "calibration") == arm
    assert len(calibration.unloaded) == 4
    assert calibration.as_described
    assert calibration.last_unloaded_ns > 1.7e18  # of this century
    np.testing.assert_array_equal(read_calibration(file, FeltArm(arm)).mean, calibration.mean)


@pytest.mark.timeout(300)
def test_a_contact_a_command_and_an_end_stop_it(graph, run, tmp_path):
    file = tmp_path / "lab.calibration"
    commissioner = run(calibration_file=str(file), poses=6)
    commands = commands_of(graph)
    begin(graph)
    graph.until(lambda: "1 of 6 holds" in status(graph), "a hold")
    graph.push(3, (0.0, 40.0, 20.0))
    graph.until(lambda: status(graph).startswith("stopped"), "the stop")
    assert "touch" in status(graph) or "untouched" in status(graph)
    count = len(commands)
    graph.spin(1.0)
    assert len(commands) == count
    assert not file.exists()
    graph.release()

    begin(graph)
    graph.command.publish(
        commands[count - 1]
    )  # as on a busy machine, where its own come back late
    graph.until(lambda: "1 of 6 holds" in status(graph), "a hold")
    names = list(open_arm("cdsm_lab").joint_names)
    graph.command.publish(JointState(name=names, position=[0.01] * 8))
    graph.until(lambda: "another node commands the arm" in status(graph), "the stop")
    graph.spin(0.5)
    assert list(commands[-1].position) == [0.01] * 8

    begin(graph)
    graph.until(lambda: "1 of 6 holds" in status(graph), "a hold")
    count = len(commands)
    commissioner.signal(signal.SIGINT)
    assert commissioner.wait() == 0
    graph.until(lambda: len(commands) > count, "the command that holds the pose")
    assert not file.exists()


@pytest.mark.timeout(300)
def test_silence_stops_it_and_without_readings_or_pose_it_does_not_begin(graph, start):
    sim = start("sim", arm="cdsm_lab", rate_hz=100.0, seed=1)
    start("commissioner", arm="cdsm_lab", poses=6, bend_deg=5.0, rest_s=0.0)
    graph.until(lambda: status(graph), "the commissioner's diagnostics")
    refused = graph.call("/commissioner/commission")
    assert not refused.success
    assert "no command on joint_commands yet" in refused.message
    names = list(open_arm("cdsm_lab").joint_names)
    graph.until(lambda: graph.command.get_subscription_count() >= 2, "arm and commissioner")
    graph.command.publish(JointState(name=names, position=[0.0] * 8))
    graph.spin(0.5)
    begin(graph)
    graph.until(lambda: "1 of 6 holds" in status(graph), "a hold")
    sim.kill()
    graph.until(lambda: "no reading for" in status(graph), "the stop")
    refused = graph.call("/commissioner/commission")
    assert not refused.success
    assert "no readings on cable_tensions" in refused.message


def test_it_needs_a_model_of_contacts_anywhere(start):
    ended = start("commissioner", arm="cdsm_lab", model="no_such_model")
    assert ended.wait() == 2
    assert "cannot start" in ended.log
