"""What all nodes share: the process from start to end, lifecycle, diagnostics (REP-107)."""

from __future__ import annotations

import gc
import signal
import sys
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import rclpy
import rclpy.utilities
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.diagnostics import Status, diagnostic_statuses
from cablesense_msgs_py.qos import PUBLISHER
from cablesense_ros.discovery import prefer_quick_discovery
from cablesense_ros.endpoints import overridable

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


SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class ConfiguredNode(LifecycleNode, ABC):
    """A lifecycle node with a parameter `autostart`, which its subclass declares."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read files and create what the node has; on failure say why and stay unconfigured."""
        try:
            self._configure()
        except CableSenseError as error:
            self._release()
            self.get_logger().error(f"cannot configure: {error}")
            return FAILURE
        except Exception:  # rclpy would drop it without a word
            self._release()
            self.get_logger().error(f"cannot configure:\n{traceback.format_exc()}")
            return FAILURE
        return super().on_configure(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget what configuring read."""
        result = super().on_cleanup(state)
        self._release()
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop from any state."""
        self._release()
        return super().on_shutdown(state)

    def autostart(self) -> None:
        """Configure and activate, unless `autostart` leaves it to a lifecycle manager."""
        if self.get_parameter("autostart").value and self.trigger_configure() == SUCCESS:
            self.trigger_activate()

    @abstractmethod
    def _configure(self) -> None:
        """Read what the parameters name, and create publishers and services.

        Raises:
            CableSenseError: a file is missing or invalid.
        """

    @abstractmethod
    def _release(self) -> None:
        """Stop, and undo whatever of `_configure` has been done; harmless when repeated."""


def run_configured_node(make: Callable[[], ConfiguredNode], args: Sequence[str] | None) -> int:
    """Run such a node, started as `autostart` says; the process's exit code."""

    def make_node() -> ConfiguredNode:
        node = make()
        node.autostart()
        return node

    return run_node(make_node, args)


WARN_EVERY_S = 1.0
"""At most one warning of a kind in this time; diagnostics count what was not logged."""
_PERIOD_S = 1.0


class DiagnosticsPublisher:
    """Asks `report` once a second for the node's statuses and publishes them."""

    def __init__(
        self, node: Node, report: Callable[[], Sequence[Status]], hardware_id: Callable[[], str]
    ) -> None:
        """`hardware_id` gives the arm's identity, empty while none is loaded."""
        self._node = node
        self._report = report
        self._hardware_id = hardware_id
        self._publisher = node.create_publisher(
            DiagnosticArray, topics.DIAGNOSTICS, **overridable(PUBLISHER)
        )
        node.create_timer(_PERIOD_S, self._publish)

    def _publish(self) -> None:
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = diagnostic_statuses(
            self._report(), self._node.get_name(), self._hardware_id(), DiagnosticStatus, KeyValue
        )
        self._publisher.publish(message)
