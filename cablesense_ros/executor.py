"""The executor of all nodes, wherever the release of ROS at hand has it."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from rclpy.executors import Executor, SingleThreadedExecutor

_PLACES = ("rclpy.executors", "rclpy.experimental", "rclpy.experimental.events_executor")
"""Modules that have `EventsExecutor`, from where it may come to stay to where it began."""


def find_executor() -> Callable[[], Executor]:
    """The events executor, which has the least latency; without it the one of a single thread."""
    for place in _PLACES:
        try:
            module = import_module(place)
        except ImportError:
            continue
        if found := getattr(module, "EventsExecutor", None):
            return found
    return SingleThreadedExecutor


make_executor = find_executor()
"""Makes an executor."""
