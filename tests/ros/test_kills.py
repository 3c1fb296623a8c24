"""kill -9 of each process under load: the others go on, and who comes back is right again."""

import signal
import time

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from ros_graph import NodeProcess, force

from cablesense_msgs_py.qos import Qos
from cablesense_ros.endpoints import qos_profile

rclpy = pytest.importorskip("rclpy")


pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

LOAD_N = np.array([0.0, 30.0, -40.0])
SEGMENT = 3


class Nodes:
    """The whole chain; any of it can be killed and started again."""

    def __init__(self, folder):
        link = folder / "adapter"
        self.given = {
            "sim_node": {"rate_hz": 100.0, "remaps": {"cable_tensions": "simulated_tensions"}},
            "can_emulator_node": {"channel": link},
            "can_driver_node": {
                "interface": "slcan",
                "channel": link,
                "bitrate_bit_s": 1_000_000,
            },
            "estimator_node": {"state_file": folder / "state.json"},
        }
        self.running = {}

    def start(self, name):
        self.running[name] = NodeProcess(f"cablesense_ros.{name}", **self.given[name])

    def kill(self, name):
        self.running[name].kill()

    def others(self, name):
        return [one.alive for n, one in self.running.items() if n != name]


@pytest.fixture(scope="module")
def nodes(graph, tmp_path_factory):
    chain = Nodes(tmp_path_factory.mktemp("kills"))
    for name in chain.given:
        chain.start(name)
    estimator = chain.running["estimator_node"]
    graph.until(lambda: "tare taken by itself" in estimator.log, "a tare of the unloaded arm")
    yield chain
    for process in chain.running.values():
        process.signal(signal.SIGHUP)  # as of a terminal that is closed
        assert process.wait() == 0, process.log
        assert "Traceback" not in process.log


def until_right(graph, what):
    """Push until the estimator finds it, ten times in a row."""
    graph.wrenches.clear()

    def right():
        graph.push(SEGMENT, LOAD_N)
        last = graph.wrenches[-10:]
        return len(last) == 10 and all(
            one.header.frame_id == f"segment_{SEGMENT}"
            and np.linalg.norm(np.array(force(one)) - LOAD_N) < 3.0
            for one in last
        )

    graph.until(right, what)


def zero_since(wrench, time_s):
    """Whether it is zero, and of a later time."""
    stamp = wrench.header.stamp
    later = stamp.sec + stamp.nanosec * 1e-9 > time_s
    return later and wrench.header.frame_id == "base_link" and force(wrench) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("victim", ["can_driver_node", "sim_node", "estimator_node"])
def test_the_others_go_on_and_it_is_right_again(graph, nodes, victim):
    until_right(graph, "the load before the kill")
    killed_s = time.time()
    nodes.kill(victim)
    if victim != "estimator_node":
        graph.until(lambda: zero_since(graph.wrenches[-1], killed_s), "a zero wrench")
    nodes.start(victim)
    until_right(graph, f"the load after {victim} came back")
    assert all(nodes.others(victim))


def test_an_estimator_that_comes_back_logs_the_tare_that_it_continues_with(nodes):
    assert "goes on with the tare and the command of" in nodes.running["estimator_node"].log


def test_liveliness_shows_a_subscriber_that_the_estimator_died_and_came_back(graph, nodes):
    nodes.kill("estimator_node")
    alive = []
    subscription = graph.node.create_subscription(
        WrenchStamped,
        "/estimator/wrench",
        lambda _: None,
        qos_profile(Qos(depth=10, reliable=True, lease_s=0.5)),
        event_callbacks=SubscriptionEventCallbacks(
            liveliness=lambda event: alive.append(event.alive_count)
        ),
    )
    nodes.start("estimator_node")
    graph.until(lambda: alive and alive[-1] == 1, "a living estimator")
    nodes.kill("estimator_node")
    graph.until(lambda: alive[-1] == 0, "its death")
    nodes.start("estimator_node")
    graph.until(lambda: alive[-1] == 1, "its return")
    graph.node.destroy_subscription(subscription)
