"""What all nodes share: the process from start to end, lifecycle, diagnostics after REP-107."""

from __future__ import annotations

import faulthandler
import gc
import os
import signal
import sys
import threading
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import rclpy
import rclpy.utilities
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.time_source import CLOCK_TOPIC, TimeSource
from rclpy.timer import Timer

from cablesense_base import CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Level, Status, diagnostic_statuses
from cablesense_msgs_py.qos import PUBLISHER
from cablesense_ros.discovery import prefer_quick_discovery
from cablesense_ros.endpoints import WARN_EVERY_S, overridable
from cablesense_ros.parameters import declare_parameters, parameter_table, parameter_values
from cablesense_ros.processes import handle_end_signals


@cache
def refuse_negative_clock() -> None:
    """Leave the time as it is at a `/clock` before 1970, which rclpy would end the process for."""
    take = TimeSource.clock_callback

    def checked(source: TimeSource, message: Any) -> None:
        try:
            take(source, message)
        except ValueError as error:
            get_logger("clock").warning(
                f"{CLOCK_TOPIC} is {message.clock.sec} s: refused, the time stays ({error})",
                throttle_duration_sec=WARN_EVERY_S,
            )

    TimeSource.clock_callback = checked


_WAKE_S = 0.2
_DESTROYED_AFTER_S = 4.0  # launch ends with a signal that nobody can handle after five
_RCLError = rclpy_implementation.RCLError


def run_node(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT, SIGTERM, SIGHUP or shutdown; give the process's exit code.

    0 after a wanted end, however often Ctrl-C is pressed; 2 with one line on stderr when the node
    cannot start. A `ConfiguredNode` is configured and activated where its `autostart` asks for it.
    """
    prefer_quick_discovery()
    refuse_negative_clock()
    wanted_end = Future()
    given = None if args is None else list(args)
    try:
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    except (_RCLError, ValueError) as error:
        return _cannot_start(error)
    handle_end_signals(lambda *_: wanted_end.set_result(None))
    node: Node | None = None
    code = 0
    try:
        node = make_node()
        if isinstance(node, ConfiguredNode):
            node.autostart()
        gc.collect()
        gc.freeze()  # what is there now stays: a collection that walks it takes milliseconds
        _spin(node, wanted_end)
    except CableSenseError as error:
        code = _cannot_start(error)
    except ExternalShutdownException:
        pass
    handle_end_signals(signal.SIG_IGN)  # the end is under way and must not be cut short
    if node is not None:
        with suppress(_RCLError):
            _destroy(node)
    rclpy.utilities.try_shutdown()
    return code


def _destroy(node: Node) -> None:
    """Destroy a node; where that takes forever, the process ends with code 1.

    Fast DDS 2.14 never comes back, at full load and with Python's lock held, when another
    participant is discovered just then (eProsima/Fast-DDS#6513).
    """
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        faulthandler.dump_traceback_later(_DESTROYED_AFTER_S, exit=True, file=nowhere)
        try:
            node.destroy_node()
        finally:
            faulthandler.cancel_dump_traceback_later()


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


def _cannot_start(error: Exception) -> int:
    print(f"cannot start: {' '.join(str(error).split())}", file=sys.stderr)
    return 2


@contextmanager
def spun_node(name: str, namespace: str = "") -> Iterator[tuple[Node, EventsExecutor]]:
    """A node in a process that has work of its own, and the executor for the caller to spin."""
    prefer_quick_discovery()
    with ExitStack() as stack:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(rclpy.utilities.try_shutdown)
        node = Node(name, namespace=namespace or None)
        stack.callback(_destroy, node)
        executor = EventsExecutor()
        stack.callback(executor.shutdown)
        executor.add_node(node)
        yield node, executor


@contextmanager
def node_in_thread(name: str) -> Iterator[Node]:
    """A node in a process that has work of its own; its callbacks run in another thread."""
    end = Future()
    with spun_node(name) as (node, executor):

        def spin() -> None:
            while not end.done():
                executor.spin_until_future_complete(end, timeout_sec=_WAKE_S)

        thread = threading.Thread(target=spin, name=name)
        thread.start()
        try:
            yield node
        finally:
            end.set_result(None)
            thread.join()


SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class ConfiguredNode(LifecycleNode, ABC):
    """A lifecycle node with the parameters of its name in `parameters.yaml`, and diagnostics.

    `_entities` undoes on release what configuring made, `_while_active` on deactivation what
    activating made; `_identity` is that of the arm, while one is loaded.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._entities = ExitStack()
        self._while_active = ExitStack()
        self._active = False
        self._identity = ""
        self._ended = False
        declare_parameters(self, parameter_table(name), lambda: bool(self._identity))
        publish_diagnostics(self, self._report, lambda: self._identity)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read files and create what the node has; on failure log why and stay unconfigured."""
        if not self._done("configure", lambda: self._configure(parameter_values(self))):
            self._release()
            return FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin what the node is for; on failure log why and stay inactive."""
        result = super().on_activate(state)
        if not self._done("activate", self._begin):
            self.on_deactivate(state)
            return FAILURE
        self._active = True
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop; what was configured stays."""
        self._active = False
        self._while_active.close()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget what configuring read."""
        result = super().on_cleanup(state)
        self._release()
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop from any state, for good."""
        self._release()
        self._ended = True
        return super().on_shutdown(state)

    def destroy_node(self) -> None:
        """Undo what configuring made first: threads may publish, and a state may not be kept."""
        self._release()
        super().destroy_node()

    def autostart(self) -> None:
        """Configure and activate, unless `autostart` leaves it to a lifecycle manager."""
        if self.get_parameter("autostart").value and self.trigger_configure() == SUCCESS:
            self.trigger_activate()

    @abstractmethod
    def _configure(self, given: dict[str, Any]) -> None:
        """Read what the parameters name, and create publishers and services.

        Raises:
            CableSenseError: a file is missing or invalid.
        """

    def _begin(self) -> None:
        """Make what the node has while it is active."""

    def _done(self, what: str, act: Callable[[], None]) -> bool:
        """Whether an act succeeded; rclpy would drop the reason in silence."""
        try:
            act()
        except Exception as error:
            expected = isinstance(error, CableSenseError)
            reason = f" {error}" if expected else f"\n{traceback.format_exc()}"
            self.get_logger().error(f"cannot {what}:{reason}")
            return False
        return True

    def _release(self) -> None:
        """Stop, and undo whatever of `_configure` has been done; harmless when repeated."""
        self._active = False
        with self._entities, self._while_active:
            self._identity = ""

    def _report(self) -> list[Status]:
        if self._ended:
            text = "shut down: it cannot be configured again, end the process and start it anew"
            return [Status("lifecycle", Level.WARN, text)]
        return self._statuses()

    @abstractmethod
    def _statuses(self) -> list[Status]:
        """The node's diagnostics at present."""


_PERIOD_S, _CLOCK_LOGGED_EVERY_S = 1.0, 10.0


def steady_timer(node: Node, period_s: float, act: Callable[[], None]) -> Timer:
    """A timer that goes on where simulated time stops, as it may at any moment."""
    return node.create_timer(period_s, act, clock=Clock(clock_type=ClockType.STEADY_TIME))


def publish_diagnostics(
    node: Node, report: Callable[[], Sequence[Status]], identity: Callable[[], str]
) -> None:
    """Publish a node's statuses once a second; `identity` is the arm's, or empty.

    Where simulated time is asked for and stands still, that is a status, and logged.
    """
    publisher = node.create_publisher(
        DiagnosticArray, topics.DIAGNOSTICS, **overridable(PUBLISHER)
    )
    last_ns = -1

    def publish() -> None:
        nonlocal last_ns
        now, statuses = node.get_clock().now(), list(report())
        if node.get_clock().ros_time_is_active and now.nanoseconds == last_ns:
            stands = f"stands at {last_ns * 1e-9:.3f} s" if last_ns else "has not begun"
            text = f"use_sim_time is set, and {CLOCK_TOPIC} {stands}: is its publisher running?"
            statuses.append(Status("clock", Level.WARN, text))
            node.get_logger().warning(text, throttle_duration_sec=_CLOCK_LOGGED_EVERY_S)
        last_ns = now.nanoseconds
        message = diagnostic_array(node, statuses, identity())
        message.header.stamp = now.to_msg()
        publisher.publish(message)

    steady_timer(node, _PERIOD_S, publish)


def diagnostic_array(node: Node, statuses: Sequence[Status], identity: str) -> DiagnosticArray:
    """Statuses of a node, not stamped, under its name and an arm's identity with the namespace."""
    hardware_id = "/".join(filter(None, (node.get_namespace().strip("/"), identity)))
    message = DiagnosticArray()
    message.status = diagnostic_statuses(
        statuses, full_name(node, node.get_name()), hardware_id, DiagnosticStatus, KeyValue
    )
    return message


def full_name(node: Node, name: str) -> str:
    """A node's name with its namespace, as in diagnostics; a relative `name` is in `node`'s."""
    return (name if name.startswith("/") else f"{node.get_namespace()}/{name}").strip("/")
