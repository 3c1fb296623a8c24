"""The CAN driver as a process: an adapter on a pseudo-terminal, and the real middleware."""

import time
from datetime import UTC, datetime

import numpy as np
import pytest
from can_frames import PACKED, PACKED_DATABASE
from lifecycle_msgs.msg import Transition
from ros_graph import NodeProcess
from sensor_msgs.msg import JointState

from cablesense_online.can.channel_map import (
    CalibratedSensor,
    Calibration,
    signal_conversion,
    write_calibration,
)
from cablesense_online.can.emulator import Emulator
from cablesense_online.can.slcan import SlcanPort
from cablesense_sim.arm import open_arm

rclpy = pytest.importorskip("rclpy")


pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

DRIVER = "cablesense_ros.can_driver_node"
ARM = open_arm("cdsm")
TENSIONS_N = np.linspace(40.0, 62.0, 12)


class Adapter(Emulator):
    """An amplifier behind an adapter that can be pulled."""

    def __init__(self, link):
        super().__init__(PACKED, PACKED_DATABASE, lambda: SlcanPort(str(link)))
        self.link = str(link)

    def send(self, tensions_n=TENSIONS_N):
        self.cycle(tensions_n)
        time.sleep(0.005)


@pytest.fixture(scope="module")
def adapter(tmp_path_factory):
    adapter = Adapter(tmp_path_factory.mktemp("can") / "adapter")
    yield adapter
    adapter.close()


@pytest.fixture(scope="module")
def driver(adapter, tmp_path_factory):
    """With a calibration of cable_2, in place of the scale and zero of the map."""
    channel = PACKED.channels["cable_2"]
    unit, factor, offset = signal_conversion(PACKED_DATABASE, channel)
    sensor = CalibratedSensor(
        message=channel.message,
        signal=channel.signal,
        signal_unit=unit,
        signal_factor=factor,
        signal_offset=offset,
        scale_n_per_unit=2.0,
        zero=10.0,
    )
    others = [cable for cable in PACKED.channels if cable != "cable_2"]
    made = datetime(2026, 3, 1, tzinfo=UTC)
    path = tmp_path_factory.mktemp("calibration") / "calibration.yaml"
    write_calibration(
        path,
        Calibration(map=PACKED.name, made=made, uncalibrated=others, cables={"cable_2": sensor}),
    )
    process = NodeProcess(
        DRIVER,
        interface="slcan",
        channel=adapter.link,
        bitrate_bit_s=1_000_000,
        calibration=path,
    )
    yield process
    assert "calibration of 2026-03-01" in process.log
    assert process.stop() == 0, process.log
    assert "Traceback" not in process.log


def tensions_come(graph, adapter, count=20, tensions_n=TENSIONS_N):
    graph.tensions.clear()

    def enough():
        adapter.send(tensions_n)
        return len(graph.tensions) >= count

    graph.until(enough, "tensions")


def status(graph, name):
    return graph.statuses.get(f"can_driver: {name}")


def reported(graph, name):
    """The last message of diagnostics under a name; empty before the first report."""
    found = status(graph, name)
    return found.message if found is not None else ""


def test_tensions_are_published_as_the_sim_does(graph, adapter, driver):
    tensions_come(graph, adapter)
    message = graph.tensions[-1]
    assert list(message.name) == list(ARM.cable_names)
    assert message.header.frame_id == "base_link"
    assert not message.position
    assert not message.velocity
    calibrated_n = TENSIONS_N.copy()
    calibrated_n[1] = 2.0 * (TENSIONS_N[1] - 10.0)
    np.testing.assert_allclose(message.effort, calibrated_n, atol=0.11)
    stamp_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
    assert abs(time.time() - stamp_s) < 1.0
    (info,) = graph.node.get_publishers_info_by_topic("/cable_tensions")
    assert info.qos_profile.reliability == rclpy.qos.ReliabilityPolicy.RELIABLE


def test_an_arm_without_sensors_in_its_joints_is_shown_where_it_was_commanded(graph, driver):
    shown = graph.listen(JointState, "/joint_states")
    graph.until(lambda: shown, "joint states")
    np.testing.assert_array_equal(shown[-1].position, np.zeros(8))
    graph.until(graph.command.get_subscription_count, "a reader of commands")
    graph.command.publish(JointState(name=list(ARM.joint_names)[::-1], position=[0.05] * 8))
    graph.until(lambda: np.ptp([*shown[-1].position, 0.05]) == 0.0, "the set-point to arrive")
    assert any(0.0 < state.position[0] < 0.05 for state in shown)


def test_diagnostics_give_the_state_and_the_arm(graph, adapter, driver):
    def fine():
        adapter.send()
        return reported(graph, "samples") == "every sample whole" and status(graph, "interface")

    graph.until(fine, "a report that all is well")
    assert status(graph, "interface").hardware_id == ARM.identity
    assert "receiving on slcan" in status(graph, "interface").message


def test_a_lifecycle_manager_brings_it_up_and_down_and_up_again(graph):
    name = "/managed/can_driver"
    process = NodeProcess(
        DRIVER, namespace="/managed", autostart=False, interface="virtual", channel="managed"
    )
    for _ in range(2):
        assert graph.change_state(name, Transition.TRANSITION_CONFIGURE), process.log
        assert graph.change_state(name, Transition.TRANSITION_ACTIVATE)
        assert graph.change_state(name, Transition.TRANSITION_DEACTIVATE)
        assert graph.change_state(name, Transition.TRANSITION_CLEANUP)
    assert process.stop() == 0, process.log
    assert "Traceback" not in process.log
