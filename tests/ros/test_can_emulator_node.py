"""From tensions to frames to tensions, through two processes and the real middleware."""

import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_graph import Graph, NodeProcess
from sensor_msgs.msg import JointState

from cablesense_sim.arm import open_arm

rclpy = pytest.importorskip("rclpy")


pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

EMULATOR, DRIVER = "cablesense_ros.can_emulator_node", "cablesense_ros.can_driver_node"
ARM = open_arm("cdsm")
TENSIONS_N = np.linspace(40.0, 62.0, 12)


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
def emulator(link):
    process = NodeProcess(EMULATOR, channel=link)
    yield process
    assert process.stop() == 0, process.log
    assert "Traceback" not in process.log
    assert not link.is_symlink()


@pytest.fixture(scope="module")
def driver(link, emulator):
    process = NodeProcess(DRIVER, interface="slcan", channel=link, bitrate_bit_s=1_000_000)
    yield process
    assert process.stop() == 0, process.log
    assert "Traceback" not in process.log


def feed(graph, condition, what):
    message = JointState(name=list(ARM.cable_names)[::-1], effort=TENSIONS_N[::-1].tolist())

    def fed():
        graph.simulated.publish(message)
        return condition()

    graph.until(fed, what)


def reported(graph, name):
    """The last message of diagnostics under a name; empty before the first report."""
    found = graph.statuses.get(name)
    return found.message if found is not None else ""


def ask(graph, text):
    client = graph.node.create_client(SetParameters, "/can_emulator/set_parameters")
    graph.until(client.service_is_ready, "the emulator's parameters")
    parameter = Parameter("fault", value=text).to_parameter_msg()
    future = client.call_async(SetParameters.Request(parameters=[parameter]))
    graph.until(future.done, "the answer")
    graph.node.destroy_client(client)
    return future.result().results[0]


def test_what_goes_in_as_tensions_comes_out_as_tensions(graph, driver):
    feed(graph, lambda: len(graph.tensions) >= 10, "tensions")
    message = graph.tensions[-1]
    assert list(message.name) == list(ARM.cable_names)
    np.testing.assert_allclose(message.effort, TENSIONS_N, atol=0.051)


def test_a_fault_is_shown_while_it_is_asked_for(graph, emulator, driver):
    assert not ask(graph, "missing_channel cable_99").successful
    assert ask(graph, "over_range cable_3").successful
    graph.spin(0.3)
    feed(
        graph,
        lambda: "over range (cable_3)" in reported(graph, "can_driver: samples"),
        "the fault in the driver's diagnostics",
    )
    feed(
        graph,
        lambda: "over_range cable_3" in reported(graph, "can_emulator: frames"),
        "the fault in the emulator's diagnostics",
    )
    graph.tensions.clear()
    assert ask(graph, "").successful
    feed(graph, lambda: len(graph.tensions) >= 3, "tensions again")


def test_an_interface_that_vanishes_on_request_comes_back(graph, link, driver):
    assert ask(graph, "interface_lost").successful
    assert not link.is_symlink()
    graph.until(lambda: "is not open" in reported(graph, "can_driver: interface"), "the loss")
    graph.tensions.clear()
    assert ask(graph, "").successful
    feed(graph, lambda: len(graph.tensions) >= 3, "tensions again")


def test_an_emulator_that_is_killed_and_comes_back_is_read_again(graph, emulator, driver):
    emulator.kill()
    graph.until(lambda: "is not open" in reported(graph, "can_driver: interface"), "the loss")
    graph.tensions.clear()
    emulator.start()
    feed(graph, lambda: len(graph.tensions) >= 5, "tensions again")
