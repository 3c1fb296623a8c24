"""What all nodes share: endpoints, refusals, the process from start to end, lifecycle.

Endpoints are the contract's topics in rclpy's terms; diagnostics follow REP-107.
"""

from __future__ import annotations

import gc
import math
import signal
import sys
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, partial
from importlib import import_module
from inspect import Parameter, Signature
from typing import Any

import rclpy
import rclpy.utilities
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.time_source import CLOCK_TOPIC, TimeSource
from rclpy.timer import Timer

from cablesense_base import CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Level, Status, diagnostic_statuses
from cablesense_msgs_py.qos import PUBLISHER, Qos
from cablesense_msgs_py.serialized import require_bounded
from cablesense_msgs_py.topics import ContractError
from cablesense_online.samples import FollowedPublisher, SampleError
from cablesense_ros.discovery import prefer_quick_discovery
from cablesense_ros.parameters import declare_parameters, parameter_table, parameter_values
from cablesense_ros.processes import handle_end_signals


def qos_profile(qos: Qos) -> QoSProfile:
    """A new profile: rclpy writes overrides into the one it is given."""
    durable, reliable = qos.transient_local, qos.reliable
    profile = QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if durable else DurabilityPolicy.VOLATILE,
    )
    if qos.lease_s:
        profile.liveliness = LivelinessPolicy.AUTOMATIC
        profile.liveliness_lease_duration = Duration(seconds=qos.lease_s)
    return profile


def overridable(qos: Qos) -> dict[str, Any]:
    """Keywords of a publisher or subscription: this quality, open to parameters.

    History, depth and reliability may be overridden by parameters that are named
    `qos_overrides.<topic>.<publisher|subscription>.<policy>`.
    """
    overriding = QoSOverridingOptions.with_default_policies()
    return {"qos_profile": qos_profile(qos), "qos_overriding_options": overriding}


def subscribe_to_one(
    node: Node,
    kind: type,
    topic: str,
    qos: Qos,
    publisher: FollowedPublisher,
    take: Callable[[bytes], object],
    refuse: Callable[[SampleError], object],
    accept: Callable[[int, float], bool] | None = None,
    **events: Callable[[Any], None],
) -> Subscription:
    """A raw subscription of which `take` gets the messages of one publisher, never of two in turn.

    Args:
        node: subscribes.
        kind: of the messages.
        topic: of theirs.
        qos: asked for.
        publisher: who is followed.
        take: takes a serialized message of that publisher.
        refuse: takes why a message of another is not used.
        accept: in place of `publisher.accept`, which it calls.
        events: callbacks of other events, by the names of rclpy.
    """
    accept = accept or publisher.accept

    def receive(message: Any, information: Any = None) -> None:
        if information is None:  # the events executor of rclpy 7.1 gives both as one tuple
            message, information = message
        try:
            another = accept(information["publication_sequence_number"], time.monotonic())
        except SampleError as problem:
            refuse(problem)
            return
        if another:
            node.get_logger().warning(
                f"{topic}: messages of another publisher, or of one of several, are used from "
                "now on",
                throttle_duration_sec=WARN_EVERY_S,
            )
        take(message)

    # rclpy looks at the signature for whether information is wanted
    receive.__signature__ = Signature(  # type: ignore[attr-defined]
        [Parameter(name, Parameter.POSITIONAL_ONLY) for name in ("message", "information")]
    )
    return node.create_subscription(
        kind,
        topic,
        receive,
        **overridable(qos),
        raw=True,
        event_callbacks=SubscriptionEventCallbacks(
            matched=lambda event: publisher.matched(event.current_count), **events
        ),
    )


def of_node(node_name: str, topic: str) -> str:
    """A private topic (`~/…`) of a node, as another node names it."""
    return topic.replace("~", node_name, 1)


def message_class(kind: str) -> type | None:
    """The class of `sensor_msgs/msg/JointState` and the like; none where it is not installed."""
    package, _, name = kind.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name, None)
    except ModuleNotFoundError:
        return None


WARN_EVERY_S = 1.0
"""At most one warning of a kind in this time; diagnostics count what was not logged."""


class RefusalLog:
    """Warns of refused messages, at most once in `WARN_EVERY_S` for a topic and kind of error.

    rclpy throttles all warnings of one line of code together, so that one kind would hide another.
    """

    def __init__(self, node: Node, what: str = "message refused") -> None:
        self._node, self._what = node, what
        self._logged_s: dict[tuple[str, object], float] = {}
        self.count = 0

    def __call__(self, topic: str, error: CableSenseError) -> None:
        """Count and warn that a message on `topic` was refused for `error`."""
        self.count += 1
        kind, now_s = (topic, getattr(error, "kind", type(error))), time.monotonic()
        if now_s - self._logged_s.get(kind, -math.inf) >= WARN_EVERY_S:
            self._logged_s[kind] = now_s
            self._node.get_logger().warning(f"{topic}: {self._what}: {error}")

    def guarded(self, topic: str, handle: Callable[[Any], object]) -> Callable[[Any], None]:
        """A callback that refuses what `handle` raises a `CableSenseError` for."""

        def take(message: Any) -> None:
            try:
                handle(message)
            except CableSenseError as error:
                self(topic, error)

        return take

    def subscribe(
        self,
        kind: type,
        topic: str,
        qos: Qos,
        handle: Callable[[Any], object],
        publisher: FollowedPublisher | None = None,
        accept: Callable[[int, float], bool] | None = None,
    ) -> Subscription:
        """A subscription of the node, guarded so; what is too long is refused unread.

        With a `publisher` to follow, messages of others are refused (`subscribe_to_one`).
        """

        def take(raw: bytes) -> None:
            require_bounded(raw)
            try:
                message = deserialize_message(raw, kind)
            except Exception as error:  # of the middleware, each its own
                raise ContractError(f"no message of its type ({error})") from error
            handle(message)

        guarded = self.guarded(topic, take)
        if publisher is None:
            return self._node.create_subscription(
                kind, topic, guarded, **overridable(qos), raw=True
            )
        refuse = partial(self, topic)
        return subscribe_to_one(self._node, kind, topic, qos, publisher, guarded, refuse, accept)


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
        stack.callback(node.destroy_node)
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

    `_entities` undoes on release what configuring made; `_identity` is that of the arm, while one
    is loaded.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._entities = ExitStack()
        self._active = False
        self._identity = ""
        self._ended = False
        declare_parameters(self, parameter_table(name), lambda: bool(self._identity))
        publish_diagnostics(self, self._report, lambda: self._identity)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read files and create what the node has; on failure log why and stay unconfigured."""
        try:
            self._configure(parameter_values(self))
        except Exception as error:  # rclpy would drop it in silence
            self._release()
            expected = isinstance(error, CableSenseError)
            reason = f" {error}" if expected else f"\n{traceback.format_exc()}"
            self.get_logger().error(f"cannot configure:{reason}")
            return FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin what the node is for."""
        result = super().on_activate(state)
        self._active = True
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop; what was configured stays."""
        self._active = False
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

    def _release(self) -> None:
        """Stop, and undo whatever of `_configure` has been done; harmless when repeated."""
        self._active = False
        self._entities.close()
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
