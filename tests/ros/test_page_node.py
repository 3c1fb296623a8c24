"""The page node: the estimator's answer to a request for a tare is shown."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser", reason="needs viser: install the extra `page`")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from cablesense_ros.page_node import PageNode

pytestmark = [pytest.mark.ros, pytest.mark.filterwarnings("ignore::DeprecationWarning")]


@pytest.mark.parametrize(("success", "title"), [(True, "Tared"), (False, "Not tared")])
def test_the_answer_to_a_tare_is_shown(monkeypatch, success, title):
    rclpy.init(args=[])
    page, estimator = PageNode(), Node("estimator")
    executor = SingleThreadedExecutor()
    try:
        executor.add_node(page)
        executor.add_node(estimator)
        answer = Trigger.Response(success=success, message="50 samples")
        estimator.create_service(Trigger, "~/tare", lambda *_: answer)
        shown = []
        monkeypatch.setattr(page._page, "notify", lambda *text: shown.append(text))
        assert page._tare.wait_for_service(10.0)
        page._ask_for_tare()
        for _ in range(200):
            executor.spin_once(timeout_sec=0.05)
            if shown:
                break
        assert shown == [(title, "50 samples")]
    finally:
        executor.shutdown()
        page.destroy_node()
        estimator.destroy_node()
        rclpy.try_shutdown()
