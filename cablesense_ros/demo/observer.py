"""The headless demo's own node, and how what happens is recorded in real time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Self, TypeVar

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from cablesense_base.arrays import Array
from cablesense_ros.discovery import prefer_quick_discovery

Moment = TypeVar("Moment")

RECORD_EVERY_S = 0.04


class Observer:
    """A node `demo` in this process; its callbacks run in a thread of their own inside `with`."""

    def __init__(self) -> None:
        prefer_quick_discovery()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("demo")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.lock = threading.Lock()
        self._thread = threading.Thread(target=self._spin, name="demo observer", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._executor.shutdown()
        self._thread.join(timeout=2.0)
        self.node.destroy_node()
        rclpy.try_shutdown()

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()


def record(
    moment: Callable[[float], Moment], duration_s: float, check: Callable[[], object]
) -> tuple[Array, list[Moment]]:
    """Act and look every `RECORD_EVERY_S`.

    Args:
        moment: takes the time since the start, s; does what is due and gives what is seen.
        duration_s: of the whole.
        check: called at every step; raises to end it.

    Returns:
        Times (K,) since the start, s, and the K moments.
    """
    start_s = time.monotonic()
    times, moments = [], []
    while (now_s := time.monotonic() - start_s) < duration_s:
        check()
        moments.append(moment(now_s))
        times.append(now_s)
        time.sleep(RECORD_EVERY_S)
    return np.array(times), moments
