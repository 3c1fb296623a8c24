"""Nodes find their executor in the present release of ROS and in those to come."""

import sys
from types import ModuleType

import pytest
import rclpy.executors
from rclpy.executors import SingleThreadedExecutor

from cablesense_ros.executor import find_executor

PLACES = ("rclpy.experimental", "rclpy.experimental.events_executor")


class MovedExecutor:
    """Stands in for the events executor of a release to come."""


@pytest.fixture
def gone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is where Jazzy has it."""
    for place in PLACES:
        monkeypatch.setitem(sys.modules, place, None)


def test_jazzy_has_the_events_executor() -> None:
    assert "events" in find_executor().__module__


@pytest.mark.usefixtures("gone")
def test_an_executor_that_has_left_the_experiments_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(rclpy.executors, "EventsExecutor", MovedExecutor, raising=False)
    assert find_executor() is MovedExecutor


def test_an_executor_without_a_module_of_its_own_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    package = ModuleType("rclpy.experimental")
    package.EventsExecutor = MovedExecutor
    monkeypatch.setitem(sys.modules, "rclpy.experimental", package)
    assert find_executor() is MovedExecutor


@pytest.mark.usefixtures("gone")
def test_without_one_the_executor_of_a_single_thread_serves() -> None:
    assert find_executor() is SingleThreadedExecutor
