"""The program of docs/controller.md stops the arm as the page says."""

import re
from collections.abc import Callable
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped

from tests.helpers.checkout import CHECKOUT

PAGE = (CHECKOUT / "docs/controller.md").read_text(encoding="utf-8")


class Subscriptions:
    """Stands for the node: keeps what it is told to call."""

    def __init__(self) -> None:
        self.on_message: dict[str, Callable[[Any], None]] = {}

    def create_subscription(
        self, kind: type, topic: str, on_message: Callable[[Any], None], qos: object
    ) -> None:
        self.on_message[topic] = on_message


@pytest.mark.parametrize(
    ("state", "upper_n", "stops"),
    [
        ("free", 0.5, False),
        ("contact", 12.0, False),
        ("contact", 21.0, True),
        ("moment", 90.0, True),
        ("unconfirmed", 30.0, True),
        ("implausible", 0.0, True),
        ("silent", 0.0, True),
    ],
)
def test_the_arm_stops(
    state: str, upper_n: float, stops: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = Subscriptions()
    monkeypatch.setattr(rclpy, "init", lambda: None)
    monkeypatch.setattr(rclpy, "create_node", lambda name: node)
    monkeypatch.setattr(rclpy, "spin", lambda node: None)
    program = next(
        text for text in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) if "STOP" in text
    )
    reasons: list[str] = []
    exec(compile(program, "docs/controller.md", "exec"), {"stop_the_arm": reasons.append})
    upper = WrenchStamped()
    upper.wrench.force.y = upper_n
    node.on_message["/estimator/wrench_upper"](upper)
    status = DiagnosticStatus(message=state)
    node.on_message["/estimator/status"](DiagnosticArray(status=[status]))
    assert bool(reasons) is stops
