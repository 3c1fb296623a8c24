"""How every node's process runs: one executor, clean ends, one line for what cannot start."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import rclpy
import rclpy.utilities
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from cablesense_msgs_py.errors import CableSenseError
from cablesense_ros.discovery import prefer_quick_discovery

_WAKE_S = 0.2
_RCLError = rclpy_implementation.RCLError


def run_node(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT, SIGTERM or shutdown; give the process's exit code.

    0 after a wanted end, however often Ctrl-C is pressed; 2 with one line on stderr when the node
    cannot start.
    """
    prefer_quick_discovery()
    wanted_end = Future()
    try:
        rclpy.init(
            args=None if args is None else list(args),
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except (_RCLError, ValueError) as error:
        return _cannot_start(error)
    _on_end_signals(lambda *_: wanted_end.set_result(None))
    node: Node | None = None
    code = 0
    try:
        node = make_node()
        gc.collect()
        gc.freeze()  # what is there now stays: a collection that walks it takes milliseconds
        _spin(node, wanted_end)
    except CableSenseError as error:
        code = _cannot_start(error)
    except ExternalShutdownException:
        pass
    _on_end_signals(signal.SIG_IGN)  # the end is under way and must not be cut short
    if node is not None:
        with suppress(_RCLError):
            node.destroy_node()
    rclpy.utilities.try_shutdown()
    return code


def _spin(node: Node, wanted_end: Future) -> None:
    """Spin in the events executor, which has the least latency.

    Its own `spin` does not return at shutdown. rclpy's signal handlers would invalidate the
    context under a callback that is running; ours only note that the end is wanted, which the
    loop sees after the callback, or when it wakes.
    """
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        while rclpy.utilities.ok() and not wanted_end.done():
            executor.spin_until_future_complete(wanted_end, timeout_sec=_WAKE_S)
    finally:
        executor.shutdown()


def _on_end_signals(action: Any) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, action)


def _cannot_start(error: Exception) -> int:
    print(f"cannot start: {' '.join(str(error).split())}", file=sys.stderr)
    return 2
