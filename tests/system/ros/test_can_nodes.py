"""From tensions to frames to tensions: emulator and driver as processes, over the middleware."""

import time
from datetime import UTC, datetime

import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import JointState

from cablesense_online.can.channel_map import (
    ScaledSensor,
    SensorScales,
    signal_conversion,
    write_sensor_scales,
)
from cablesense_sim.arm import open_arm
from tests.helpers.can_frames import PACKED, PACKED_DATABASE
from tests.helpers.ros_graph import Graph

ARM = open_arm("cdsm")
TENSIONS_N = np.linspace(40.0, 62.0, 12)
SCALE = 2.0
ZERO = 10.0
"""Of cable_2's calibration, in place of those of the map."""


@pytest.fixture(scope="module")
def graph():
    talking = Graph()
    talking.simulated = talking.node.create_publisher(JointState, "/simulated_tensions", 10)
    yield talking
    talking.close()


@pytest.fixture(scope="module")
def link(tmp_path_factory):
    return tmp_path_factory.mktemp("can") / "adapter"


@pytest.fixture(scope="module")
def emulator(link, start_for_all):
    return start_for_all("can_emulator", channel=link)


@pytest.fixture(scope="module")
def driver(link, emulator, start_for_all):
    channel = PACKED.channels["cable_2"]
    unit, factor, offset = signal_conversion(PACKED_DATABASE, channel)
    sensor = ScaledSensor(
        message=channel.message,
        signal=channel.signal,
        signal_unit=unit,
        signal_factor=factor,
        signal_offset=offset,
        scale_n_per_unit=SCALE,
        zero=ZERO,
    )
    others = [cable for cable in PACKED.channels if cable != "cable_2"]
    made = datetime(2026, 3, 1, tzinfo=UTC)
    path = link.with_name("calibration.yaml")
    sensors = {"cable_2": sensor}
    write_sensor_scales(
        path, SensorScales(map=PACKED.name, made=made, uncalibrated=others, cables=sensors)
    )
    bus = {"interface": "slcan", "channel": link, "bitrate_bit_s": 1_000_000}
    return start_for_all("can_driver", sensor_calibration_file=path, **bus)


def feed(graph, condition, what):
    """Let the emulator play tensions until something is true."""
    message = JointState(name=list(ARM.cable_names)[::-1], effort=TENSIONS_N[::-1].tolist())

    def fed():
        graph.simulated.publish(message)
        return condition()

    graph.until(fed, what)


def feed_again(graph):
    graph.tensions.clear()
    feed(graph, lambda: len(graph.tensions) >= 5, "tensions again")


def reported(graph, name):
    """The last message of diagnostics under a name; empty before the first report."""
    status_message = graph.statuses.get(name)
    return status_message.message if status_message is not None else ""


def ask(graph, fault):
    client = graph.node.create_client(SetParameters, "/can_emulator/set_parameters")
    graph.until(client.service_is_ready, "the emulator's parameters")
    parameter = Parameter("fault", value=fault).to_parameter_msg()
    future = client.call_async(SetParameters.Request(parameters=[parameter]))
    graph.until(future.done, "the answer")
    graph.node.destroy_client(client)
    return future.result().results[0]


def test_what_goes_in_comes_out_calibrated_as_the_sim_publishes_it(graph, driver):
    feed(graph, lambda: len(graph.tensions) >= 10, "tensions")
    message = graph.tensions[-1]
    assert list(message.name) == list(ARM.cable_names)
    assert message.header.frame_id == "base_link"
    assert not message.position
    assert not message.velocity
    calibrated_n = TENSIONS_N.copy()
    calibrated_n[1] = SCALE * (TENSIONS_N[1] - ZERO)
    np.testing.assert_allclose(message.effort, calibrated_n, atol=0.11)
    stamp_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
    assert abs(time.time() - stamp_s) < 1.0
    (info,) = graph.node.get_publishers_info_by_topic("/cable_tensions")
    assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert "calibration of 2026-03-01" in driver.log


def test_an_arm_without_sensors_in_its_joints_is_shown_where_it_was_commanded(graph, driver):
    shown = graph.listen(JointState, "/joint_states")
    graph.until(lambda: shown, "joint states")
    np.testing.assert_array_equal(shown[-1].position, np.zeros(8))
    graph.until(graph.command.get_subscription_count, "a reader of commands")
    graph.command.publish(JointState(name=list(ARM.joint_names)[::-1], position=[0.05] * 8))
    graph.until(lambda: np.ptp([*shown[-1].position, 0.05]) == 0.0, "the set-point to arrive")
    assert any(0.0 < state.position[0] < 0.05 for state in shown)


def test_diagnostics_give_the_state_and_the_arm(graph, driver):
    samples = "can_driver: samples"
    interface = "can_driver: interface"
    feed(graph, lambda: reported(graph, samples) == "every sample whole", "a good report")
    assert graph.statuses[interface].hardware_id == ARM.identity
    assert "receiving on slcan" in reported(graph, interface)


def test_a_fault_is_shown_while_it_is_asked_for(graph, driver):
    assert not ask(graph, "missing_channel cable_99").successful
    assert ask(graph, "over_range cable_3").successful
    for name, text in (
        ("can_driver: samples", "over range (cable_3)"),
        ("can_emulator: frames", "over_range cable_3"),
    ):
        feed(graph, lambda name=name, text=text: text in reported(graph, name), text)
    assert ask(graph, "").successful
    feed_again(graph)


def test_an_interface_that_vanishes_on_request_comes_back(graph, link, driver):
    assert ask(graph, "interface_lost").successful
    assert not link.is_symlink()
    graph.until(lambda: "is not open" in reported(graph, "can_driver: interface"), "the loss")
    assert ask(graph, "").successful
    feed_again(graph)


def test_an_emulator_that_is_killed_and_comes_back_is_read_again(graph, emulator, driver):
    emulator.kill()
    graph.until(lambda: "is not open" in reported(graph, "can_driver: interface"), "the loss")
    emulator.start()
    feed_again(graph)
