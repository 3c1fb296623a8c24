"""kill -9 of each process under load: the others go on, and who comes back is right again."""

import time

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.event_handler import SubscriptionEventCallbacks

from cablesense_contact.calibration import Calibrator, Unloaded
from cablesense_contact.calibration_file import write_calibration
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.inference.law_model import LawModel
from cablesense_contact.inference.metadata import find_model
from cablesense_msgs_py.qos import Qos
from cablesense_ros.endpoints import qos_profile
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from tests.helpers.ros_graph import force

LOAD_N = np.array([0.0, 30.0, -40.0])
SEGMENT = 3


@pytest.fixture(scope="module")
def living(graph):
    """Reports of a subscriber that asks for liveliness: how many estimators are alive."""
    living = []
    graph.node.create_subscription(
        WrenchStamped,
        "/estimator/wrench",
        lambda _: None,
        qos_profile(Qos(depth=10, reliable=True, lease_s=0.5)),
        event_callbacks=SubscriptionEventCallbacks(
            liveliness=lambda event: living.append(event.alive_count)
        ),
    )
    return living


@pytest.fixture(scope="module")
def nodes(graph, living, start_for_all, tmp_path_factory):
    """The whole chain; any of it can be killed and started again."""
    folder = tmp_path_factory.mktemp("kills")
    link = folder / "adapter"
    bus = {"interface": "slcan", "channel": link, "bitrate_bit_s": 1_000_000}
    chain = {
        "sim": start_for_all("sim", remaps={"cable_tensions": "simulated_tensions"}),
        "can_emulator": start_for_all("can_emulator", channel=link),
        "can_driver": start_for_all("can_driver", **bus),
        "estimator": start_for_all("estimator", calibration_file=calibrated(folder)),
    }
    estimator = chain["estimator"]
    graph.until(lambda: "calibrated by" in estimator.log, "the estimator")
    return chain


def calibrated(folder):
    """A calibration file by the untouched straight arm, with which no tare is needed."""
    arm = open_arm("cdsm")
    straight = np.zeros(arm.joint_count)
    reading_n = solve_equilibrium(mechanism_of(arm), straight).tensions_n
    calibrator = Calibrator(FeltArm(arm), LawModel(find_model("cdsm_anywhere"), arm))
    path = folder / "known.npz"
    write_calibration(path, calibrator.from_poses([Unloaded(reading_n, straight, count=50)]))
    return path


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


@pytest.mark.parametrize("victim", ["can_driver", "estimator"])
def test_the_others_go_on_and_it_is_right_again(graph, nodes, living, victim):
    until_right(graph, "the load before the kill")
    graph.until(lambda: living and living[-1] == 1, "a living estimator")
    killed_s = time.time()
    nodes[victim].kill()
    if victim == "estimator":
        graph.until(lambda: living[-1] == 0, "its death")
    else:
        graph.until(lambda: zero_since(graph.wrenches[-1], killed_s), "a zero wrench")
    nodes[victim].start()
    until_right(graph, f"the load after {victim} came back")
    graph.until(lambda: living[-1] == 1, "a living estimator at the end")
    assert all(node.alive for node in nodes.values())
