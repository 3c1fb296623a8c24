"""The page node: answers to a tare are shown, and what the arm cannot do is not commanded."""

import numpy as np
import pytest

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


@pytest.fixture
def executor(page):
    executor = SingleThreadedExecutor()
    executor.add_node(page)
    yield executor
    executor.shutdown()


@pytest.mark.parametrize(("success", "title"), [(True, "Tared"), (False, "Not tared")])
def test_the_answer_to_a_tare_is_shown(page, executor, success, title):
    estimator = Node("estimator")
    executor.add_node(estimator)
    answer = Trigger.Response(success=success, message="50 samples")
    estimator.create_service(Trigger, "~/tare", lambda *_: answer)
    nobody = ("Not tared", "nothing answers /estimator/tare")
    while set(page.shown) <= {nobody}:
        page._actions.tare()
        executor.spin_once(timeout_sec=0.05)
    assert set(page.shown) <= {nobody, (title, "50 samples")}
    estimator.destroy_node()


def test_what_the_arm_cannot_do_is_not_commanded_but_shown(page, executor):
    commands = []
    page.create_subscription(JointState, "joint_commands", commands.append, 10)
    for angle_rad in (np.nan, np.inf, 0.6, 2.0 * np.pi):
        page._actions.command(np.full(8, angle_rad))
    assert [title for title, _ in page.shown] == ["Not moved"] * 4
    while not commands:
        page._actions.command(np.full(8, 0.1))
        executor.spin_once(timeout_sec=0.05)
    assert {message.position[0] for message in commands} == {0.1}


@pytest.mark.parametrize("acted", [False, True])
def test_a_commissioning_is_asked_for_until_it_begins_unless_a_person_acts(
    page, executor, monkeypatch, acted
):
    commissioner = Node("commissioner")
    executor.add_node(commissioner)
    asked = []

    def answer(_, response):
        asked.append(response)
        response.success = len(asked) > 1  # at first the last command is too recent
        response.message = "8 holds"
        return response

    commissioner.create_service(Trigger, "~/commission", answer)
    monkeypatch.setattr(page._live, "reports_ok", lambda part: part == "tare")
    page._commission_due = True
    if acted:
        page._actions.command(np.full(8, 0.01))
    for _ in range(300):
        executor.spin_once(timeout_sec=0.02)
        if page.shown:
            break
    assert len(asked) == (0 if acted else 2)
    assert page.shown == ([] if acted else [("Commissioning", "8 holds")])
    commissioner.destroy_node()
