"""The page node: answers to a tare are shown, and what the arm cannot do is not commanded."""

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser", reason="needs viser: install the extra `page`")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from cablesense_ros.page_node import PageNode

pytestmark = [pytest.mark.ros, pytest.mark.filterwarnings("ignore::DeprecationWarning")]


@pytest.fixture
def page(monkeypatch):
    rclpy.init(args=[])
    page = PageNode()
    page.shown = []
    monkeypatch.setattr(page._page, "notify", lambda *text: page.shown.append(text))
    yield page
    page.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.parametrize(("success", "title"), [(True, "Tared"), (False, "Not tared")])
def test_the_answer_to_a_tare_is_shown(page, success, title):
    estimator = Node("estimator")
    executor = SingleThreadedExecutor()
    try:
        executor.add_node(page)
        executor.add_node(estimator)
        answer = Trigger.Response(success=success, message="50 samples")
        estimator.create_service(Trigger, "~/tare", lambda *_: answer)
        assert page._tare.wait_for_service(10.0)
        page._actions.tare()
        for _ in range(200):
            executor.spin_once(timeout_sec=0.05)
            if page.shown:
                break
        assert page.shown == [(title, "50 samples")]
    finally:
        executor.shutdown()
        estimator.destroy_node()


@pytest.mark.parametrize("angle_rad", [np.nan, np.inf, 0.6, 2.0 * np.pi, np.deg2rad(1e6)])
def test_what_the_arm_cannot_do_is_not_commanded_but_shown(page, angle_rad):
    commands = []
    page.create_subscription(JointState, "joint_commands", commands.append, 10)
    executor = SingleThreadedExecutor()
    executor.add_node(page)
    try:
        page._actions.command(np.full(8, angle_rad))
        while not commands:
            page._actions.command(np.full(8, 0.1))
            executor.spin_once(timeout_sec=0.05)
        assert {message.position[0] for message in commands} == {0.1}
        assert [title for title, _ in page.shown] == ["Not moved"]
    finally:
        executor.shutdown()
