"""What all nodes share: process, parameters, lifecycle, diagnostics after REP-107."""

from __future__ import annotations

import gc
import math
import re
import signal
import sys
import threading
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import rclpy
import rclpy.utilities
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.time_source import CLOCK_TOPIC

from cablesense_base import CableSenseError
from cablesense_base.installation import missing_package_line
from cablesense_base.plain_yaml import parse_plain_mapping
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Level, Status
from cablesense_msgs_py.qos import PUBLISHER_QOS
from cablesense_ros.endpoints import Outputs, qos_profile, steady_timer
from cablesense_ros.executor import make_executor
from cablesense_ros.processes import handle_end_signals, prefer_quick_discovery

_WAKE_S = 0.2
"""How often a node that ends looks whether all is done."""
_STUCK_AFTER_S = 60  # a start that compiles takes 20 s on a slow machine
_PROGRESS_S = 1.0
"""How often a node's own timer postpones the alarm of one that is stuck."""
_ENDED_WITHIN_S = 4  # launch ends with a signal that nobody can handle after five
_EXITED_WITHIN_S = 20  # Python's own end, with the threads of the page
_RCLError = rclpy_implementation.RCLError
_InvalidHandle = rclpy_implementation.InvalidHandle


def run_node(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT, SIGTERM, SIGHUP or shutdown; give the process's exit code.

    0 after a wanted end, however often Ctrl-C is pressed; 2 with one line on stderr when the node
    cannot start. A `ConfiguredNode` is configured and activated where its `autostart` asks for it.

    Fast DDS 2.14 may never come back from a call, with Python's lock held, when another
    participant is discovered at that moment (eProsima/Fast-DDS#6513). An alarm then ends the
    process: one of launch's `respawn` takes its place. The process must end after this function.
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
    if node is not None:
        signal.alarm(_EXITED_WITHIN_S)
    return code


def _spin(node: Node, wanted_end: Future) -> None:
    """Spin until the end is wanted.

    The events executor's own `spin` does not return at shutdown. rclpy's signal handlers would
    invalidate the context under a callback that is running; ours note that the end is wanted, for
    the loop. Nor does it return at its timeout while there are events: the alarm is postponed by
    a timer, which has its turn among them.
    """
    executor = make_executor()
    executor.add_node(node)
    signal.alarm(_STUCK_AFTER_S)
    steady_timer(node, _PROGRESS_S, _postpone_alarm)
    try:
        while rclpy.utilities.ok() and not wanted_end.done():
            with suppress(_InvalidHandle):  # an event of a subscription that is gone by now
                executor.spin_until_future_complete(wanted_end, timeout_sec=_WAKE_S)
    finally:
        signal.alarm(_ENDED_WITHIN_S)
        executor.shutdown()


def _postpone_alarm() -> None:
    signal.alarm(_STUCK_AFTER_S)


def _cannot_start(error: Exception) -> int:
    print(f"cannot start: {' '.join(str(error).split())}", file=sys.stderr)
    return 2


@contextmanager
def spun_node(name: str, namespace: str = "") -> Iterator[tuple[Node, Executor]]:
    """A node in a process that has other work, and the executor for the caller to spin."""
    prefer_quick_discovery()
    with ExitStack() as stack:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(rclpy.utilities.try_shutdown)
        node = Node(name, namespace=namespace or None)
        stack.callback(signal.alarm, 0)
        stack.callback(node.destroy_node)
        stack.callback(signal.alarm, _ENDED_WITHIN_S)
        executor = make_executor()
        stack.callback(executor.shutdown)
        executor.add_node(node)
        yield node, executor


@contextmanager
def node_in_thread(name: str) -> Iterator[Node]:
    """A node in a process that has other work; its callbacks run in another thread."""
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


class ParameterError(CableSenseError):
    """A parameter given at start that does not fit."""


_KINDS = {
    bool: "true or false",
    int: "a whole number",
    float: "a number with a decimal point",
    str: "text",
}
"""What a parameter may be, in words."""


@dataclass(frozen=True)
class NodeParameter:
    """One parameter of a node, as `parameters.yaml` has it.

    Attributes:
        name, description: as in `ros2 param`; the description has the unit.
        default: also fixes the type: a bool, an int, a float or a str; a list is none of these.
        bounds: least and greatest value of a number.
        choices: the texts that are allowed; empty for any.
        live: whether it may change while the node is at work; else the node reads it once.

    Raises:
        ParameterError: the default has another type.
    """

    name: str
    default: bool | int | float | str
    description: str
    bounds: Sequence[float] = ()
    choices: Sequence[str] = ()
    live: bool = False

    def __post_init__(self) -> None:
        """Refuse a default of another type."""
        if type(self.default) not in _KINDS:
            raise ParameterError(
                f"parameter {self.name}: its default {self.default!r} is of the type "
                f"{type(self.default).__name__}; it must be {', or '.join(_KINDS.values())}"
            )

    def descriptor(self, lifecycle: bool) -> ParameterDescriptor:
        """The description that `ros2 param describe` shows."""
        descriptor = ParameterDescriptor(
            description=self.description,
            read_only=not (self.live or lifecycle),
            additional_constraints=self.valid() if self.choices else "",
        )
        if self.bounds:
            low, high = self.bounds
            if isinstance(self.default, float):
                ends = FloatingPointRange(from_value=low, to_value=high)
                descriptor.floating_point_range = [ends]
            else:
                descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        return descriptor

    def valid(self) -> str:
        """The valid values, for errors."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        within = " from {:g} to {:g}".format(*self.bounds) if self.bounds else ""
        return f"{_KINDS[type(self.default)]}{within}"

    def allows(self, value: object) -> bool:
        """Whether a value of its type is finite and among the choices.

        NaN passes rclpy's own check of ranges, as it compares false with both ends.
        """
        finite = not isinstance(value, float) or math.isfinite(value)
        return finite and (not self.choices or value in self.choices)


def parameter_table(node: str) -> list[NodeParameter]:
    """The parameters of a node such as `sim`.

    Raises:
        ParameterError: the file is no plain YAML, or a default in it has another type.
    """
    text = files("cablesense_ros").joinpath("parameters.yaml").read_text(encoding="utf-8")
    tables = parse_plain_mapping(text, "parameters.yaml", "nodes", ParameterError)
    return [
        NodeParameter(name, **(tables["shared"][name] if entry == "shared" else entry))
        for name, entry in tables[node].items()
    ]


def declare_parameters(
    node: Node, table: Sequence[NodeParameter], configured: Callable[[], bool] | None = None
) -> dict[str, Any]:
    """Declare all of a table, and give their values.

    A change that would have no effect is refused: those that are not live keep the value given at
    start, or, of a lifecycle node, the one that it was `configured` with.

    Raises:
        ParameterError: a value given at start has the wrong type or lies out of range.
    """
    for parameter in table:
        must = f"it must be {parameter.valid()}"
        descriptor = parameter.descriptor(configured is not None)
        try:
            value = node.declare_parameter(parameter.name, parameter.default, descriptor).value
        except ParameterException as error:
            raise ParameterError(f"parameter {parameter.name}: {error}; {must}") from error
        if not parameter.allows(value):
            raise ParameterError(f"parameter {parameter.name} is {value}; {must}")
    by_name = {parameter.name: parameter for parameter in table}

    def check(given: list[Parameter]) -> SetParametersResult:
        for change in given:
            parameter = by_name.get(change.name)
            if parameter is None or change.value == node.get_parameter(change.name).value:
                continue
            reason = ""
            if not parameter.allows(change.value):
                reason = f"must be {parameter.valid()}, not {change.value}"
            elif configured is not None and configured() and not parameter.live:
                reason = (
                    "is read when the node is configured, so a change now would have no effect; "
                    "deactivate the node and clean it up first"
                )
            if reason:
                return SetParametersResult(successful=False, reason=f"{change.name} {reason}")
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)
    return parameter_values(node)


def parameter_values(node: Node) -> dict[str, Any]:
    """Present values by name; those in degrees, `…_deg…`, also in radians, as `…_rad…`."""
    values = {
        name: parameter.value for name, parameter in node.get_parameters_by_prefix("").items()
    }
    degrees = {name: value for name, value in values.items() if re.search(r"_deg(_|$)", name)}
    return values | {
        name.replace("_deg", "_rad"): math.radians(value) for name, value in degrees.items()
    }


SUCCESS = TransitionCallbackReturn.SUCCESS
FAILURE = TransitionCallbackReturn.FAILURE


class ConfiguredNode(LifecycleNode, ABC):
    """A lifecycle node with the parameters of its name in `parameters.yaml`, and diagnostics.

    `_entities` undoes on release what configuring made, `_while_active` on deactivation what
    activating made; `_topics` publishes while active and stays; `_identity` is that of the arm,
    while one is loaded.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._entities = ExitStack()
        self._while_active = ExitStack()
        self._topics = Outputs(self)
        self._active = False
        self._identity = ""
        declare_parameters(self, parameter_table(name), lambda: bool(self._identity))
        publish_diagnostics(self, self._statuses, lambda: self._identity)

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
        """Stop what activating began."""
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
        """Read what the parameters name, and make the topics that are published.

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
            self.get_logger().error(f"cannot {what}:{_reason(error)}")
            return False
        return True

    def _release(self) -> None:
        """Stop, and undo whatever of `_configure` has been done; harmless when repeated."""
        self._active = False
        with self._entities, self._while_active:
            self._identity = ""

    @abstractmethod
    def _statuses(self) -> list[Status]:
        """The node's diagnostics at present."""


def _reason(error: Exception) -> str:
    """What the log says of an error, after a colon: one line for those that are expected."""
    if isinstance(error, CableSenseError):
        return f" {error}"
    if isinstance(error, ModuleNotFoundError):
        return f" {missing_package_line(error)}"
    return f"\n{traceback.format_exc()}"


_PERIOD_S = 1.0
"""From one status to the next, as usual for diagnostics."""
_CLOCK_LOGGED_EVERY_S = 10.0
"""How often the log repeats that a clock was set."""


def publish_diagnostics(
    node: Node, report: Callable[[], Sequence[Status]], identity: Callable[[], str]
) -> None:
    """Publish a node's statuses once a second; `identity` is the arm's, or empty.

    If simulated time is used and stands still, a status and the log say so.
    """
    publisher = node.create_publisher(
        DiagnosticArray, topics.DIAGNOSTICS, qos_profile(PUBLISHER_QOS)
    )
    last_ns = -1

    def publish() -> None:
        nonlocal last_ns
        now = node.get_clock().now()
        statuses = list(report())
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
    before = full_name(node, node.get_name())
    hardware_id = "/".join(filter(None, (node.get_namespace().strip("/"), identity)))
    return DiagnosticArray(
        status=[
            DiagnosticStatus(
                level=bytes([status.level]),
                name=f"{before}: {status.name}",
                message=status.message,
                hardware_id=hardware_id,
                values=[KeyValue(key=key, value=value) for key, value in status.values.items()],
            )
            for status in statuses
        ]
    )


def full_name(node: Node, name: str) -> str:
    """A node's name with its namespace, as in diagnostics; a relative `name` is in `node`'s."""
    return (name if name.startswith("/") else f"{node.get_namespace()}/{name}").strip("/")
