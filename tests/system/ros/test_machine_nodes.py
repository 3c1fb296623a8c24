"""A machine that MuJoCo describes, as nodes: pushed, it says on which link, where and how hard."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, WrenchStamped

from cablesense_msgs_py.messages import ForceState
from cablesense_ros.cli.export import export
from tests.helpers.ros_graph import force

MACHINES = Path(__file__).parents[3] / "config" / "machines"


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A machine file with its model beside it."""
    folder = tmp_path_factory.mktemp("arm")
    for name in ("seven_hinges.xml", "seven_hinges.yaml"):
        shutil.copy(MACHINES / name, folder)
    file = folder / "seven_hinges.yaml"
    export(out=folder / "seven_hinges.onnx", arm=str(file))
    return file


@pytest.fixture(scope="module")
def nodes(start_for_all, arm):
    sim = start_for_all("machine_sim", machine=str(arm), built_seed=3, rate_hz=30.0)
    return sim, start_for_all("estimator", arm=str(arm), tare_samples=20)


def test_a_push_on_a_link_is_found_within_its_interval(graph, nodes):
    points = graph.listen(PointStamped, "/estimator/contact_point")
    lower = graph.listen(WrenchStamped, "/estimator/wrench_lower")
    upper = graph.listen(WrenchStamped, "/estimator/wrench_upper")
    graph.until(lambda: said(graph) is ForceState.FREE, "an arm that nothing touches")
    message = WrenchStamped()
    message.header.frame_id = "link_6"
    message.wrench.force.y = 8.0
    message.wrench.force.z = 6.0
    graph.until(graph.load.get_subscription_count, "a subscriber of loads")
    graph.load.publish(message)
    graph.until(lambda: said(graph) is ForceState.CONTACT and points, "a contact")
    wrench = graph.wrenches[-2]
    assert wrench.header.frame_id == "link_6"
    size_n = np.linalg.norm(force(wrench))
    assert size_n == pytest.approx(10.0, abs=0.5)
    low_n, high_n = (np.linalg.norm(force(bounds[-1])) for bounds in (lower, upper))
    assert low_n < 10.0 < high_n
    # in the middle of where the link is touched, which is its default place
    assert points[-1].point.x == pytest.approx(0.06, abs=0.01)


def said(graph):
    """The state of the latest wrench but one; its state comes just after it."""
    return graph.state_of(graph.wrenches[-2]) if len(graph.wrenches) > 1 else None
