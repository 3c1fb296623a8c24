"""What all nodes share: parameters, endpoints, refusals, the process from start to end, lifecycle.

Endpoints are the contract's topics in rclpy's terms; diagnostics follow REP-107.
"""

from __future__ import annotations

import gc
import math
import signal
import sys
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final

import rclpy
import rclpy.utilities
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.duration import Duration
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Status, diagnostic_statuses
from cablesense_msgs_py.qos import PUBLISHER, Qos
from cablesense_ros.discovery import prefer_quick_discovery


class ParameterError(CableSenseError):
    """A parameter given at start that does not fit: names it and what would be valid."""


@dataclass(frozen=True)
class NodeParameter:
    """One parameter of a node's table.

    Attributes:
        name: as in YAML files and `ros2 param`.
        default: also fixes the type.
        description: what it does, with its unit.
        lowest, highest: allowed range of a number.
    """

    name: str
    default: bool | int | float | str
    description: str
    lowest: float | None = None
    highest: float | None = None

    def descriptor(self, read_only: bool) -> ParameterDescriptor:
        """The description that `ros2 param describe` shows."""
        descriptor = ParameterDescriptor(description=self.description, read_only=read_only)
        if self.lowest is None or self.highest is None:
            return descriptor
        if isinstance(self.default, float):
            allowed = FloatingPointRange(from_value=self.lowest, to_value=self.highest)
            descriptor.floating_point_range = [allowed]
        else:
            low, high = int(self.lowest), int(self.highest)
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        return descriptor

    def valid(self) -> str:
        """What would be right, for errors."""
        kinds = {
            bool: "true or false",
            int: "a whole number",
            float: "a number with a decimal point",
        }
        within = "" if self.lowest is None else f" from {self.lowest:g} to {self.highest:g}"
        return f"{kinds.get(type(self.default), 'text')}{within}"


ARM: Final = NodeParameter("arm", "cdsm", "Arm file: the name of a bundled one, or a path.")
AUTOSTART: Final = NodeParameter(
    "autostart", True, "Configure and activate at start, without a lifecycle manager."
)
FRAME_PREFIX: Final = NodeParameter(
    "frame_prefix", "", "Goes before every frame name, as robot_state_publisher's parameter does."
)
JOINT_SPEED: Final = NodeParameter(
    "joint_speed_deg_s",
    20.0,
    "Peak speed at which joints approach a command, deg/s; the same for all nodes.",
    0.1,
    360.0,
)
CHANNEL_MAP: Final = NodeParameter(
    "map",
    "twelve_channel_amplifier",
    "Channel map: the name of a bundled one, or the path of a .yaml file.",
)
BITRATE: Final = NodeParameter(
    "bitrate_bit_s",
    0,
    "Bit rate of the bus, bit/s; 0 where the system sets it (socketcan) or there is none.",
    0,
    1_000_000,
)


def declare_parameters(node: Node, table: Sequence[NodeParameter], read_only: bool = True) -> None:
    """Declare all of a table; `read_only` ones keep the value given at start.

    Raises:
        ParameterError: a value given at start has the wrong type or lies out of range.
    """
    for parameter in table:
        must = f"it must be {parameter.valid()}"
        descriptor = parameter.descriptor(read_only)
        try:
            value = node.declare_parameter(parameter.name, parameter.default, descriptor).value
        except ParameterException as error:
            raise ParameterError(f"parameter {parameter.name}: {error}; {must}") from error
        if isinstance(value, float) and not math.isfinite(value):
            raise ParameterError(f"parameter {parameter.name} is {value}; {must}")
    node.add_on_set_parameters_callback(_refuse_not_finite)


def parameter_values(node: Node, table: Sequence[NodeParameter]) -> dict[str, Any]:
    """Present values by name."""
    return {parameter.name: node.get_parameter(parameter.name).value for parameter in table}


def _refuse_not_finite(parameters: list[Parameter]) -> SetParametersResult:
    """NaN passes rclpy's own check of ranges, as it compares false with both ends."""
    for parameter in parameters:
        if isinstance(parameter.value, float) and not math.isfinite(parameter.value):
            return SetParametersResult(
                successful=False, reason=f"{parameter.name} must be finite, not {parameter.value}"
            )
    return SetParametersResult(successful=True)


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
        self._node = node
        self._what = what
        self._logged_s: dict[tuple[str, type], float] = {}
        self.count = 0

    def __call__(self, topic: str, error: CableSenseError) -> None:
        """Count and warn that a message on `topic` was refused for `error`."""
        self.count += 1
        kind, now_s = (topic, type(error)), time.monotonic()
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


_WAKE_S = 0.2
_RCLError = rclpy_implementation.RCLError


def run_node(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT, SIGTERM or shutdown; give the process's exit code.

    0 after a wanted end, however often Ctrl-C is pressed; 2 with one line on stderr when the node
    cannot start.
    """
    prefer_quick_discovery()
    wanted_end = Future()
    given = None if args is None else list(args)
    try:
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
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


@contextmanager
def spun_node(name: str, namespace: str = "") -> Iterator[tuple[Node, EventsExecutor]]:
    """A node in a process that has work of its own, and the executor for the caller to spin."""
    prefer_quick_discovery()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node(name, namespace=namespace or None)
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.shutdown()
        node.destroy_node()
        with suppress(RuntimeError):
            rclpy.utilities.try_shutdown()


SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class ConfiguredNode(LifecycleNode, ABC):
    """A lifecycle node with a parameter `autostart`, which its subclass declares."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read files and create what the node has; on failure log why and stay unconfigured."""
        try:
            self._configure()
        except Exception as error:  # rclpy would drop it in silence
            self._release()
            expected = isinstance(error, CableSenseError)
            reason = f" {error}" if expected else f"\n{traceback.format_exc()}"
            self.get_logger().error(f"cannot configure:{reason}")
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
