"""How every node's process runs: one executor, clean ends, one line for what cannot start."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress

import rclpy
import rclpy.signals
import rclpy.utilities
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from cablesense_msgs_py.errors import CableSenseError

_WAKE_S = 1.0
_RCLError = rclpy_implementation.RCLError


def run_node(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT, SIGTERM or shutdown; give the process's exit code.

    0 after a wanted end, however often Ctrl-C is pressed; 2 with one line on stderr when the node
    cannot start.
    """
    try:
        rclpy.init(
            args=None if args is None else list(args),
            signal_handler_options=SignalHandlerOptions.ALL,
        )
    except (_RCLError, ValueError) as error:
        return _cannot_start(error)
    node: Node | None = None
    code = 0
    try:
        node = make_node()
        gc.collect()
        gc.freeze()  # what is there now stays: a collection that walks it takes milliseconds
        _spin(node)
    except CableSenseError as error:
        code = _cannot_start(error)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    _ignore_further_interrupts()
    if node is not None:
        with suppress(_RCLError):
            node.destroy_node()
    rclpy.utilities.try_shutdown()
    return code


def _spin(node: Node) -> None:
    """Spin in the events executor, which has the least latency.

    Its own `spin` does not return at shutdown, hence
    the loop over a future that never completes.
    """
    executor = EventsExecutor()
    executor.add_node(node)
    never: Future = Future()
    try:
        while rclpy.utilities.ok():
            executor.spin_until_future_complete(never, timeout_sec=_WAKE_S)
    finally:
        _ignore_further_interrupts()
        executor.shutdown()


def _ignore_further_interrupts() -> None:
    """The end is under way: a second Ctrl-C or SIGTERM must not cut it short."""
    rclpy.signals.uninstall_signal_handlers()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


def _cannot_start(error: Exception) -> int:
    print(f"cannot start: {' '.join(str(error).split())}", file=sys.stderr)
    return 2
