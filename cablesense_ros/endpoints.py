"""The contract's topics in rclpy's terms: publishers, subscriptions, refusals, timers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from inspect import Parameter, Signature
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSPublisherMatchedInfo,
    SubscriptionEventCallbacks,
)
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions, QoSPolicyKind
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import COMMAND_QOS, PUBLISHER_QOS, Qos
from cablesense_msgs_py.serialized import MAX_CALIBRATION_BYTES, MAX_MESSAGE_BYTES, require_bounded
from cablesense_msgs_py.topics import ContractError
from cablesense_online.followed_publisher import FollowedPublisher
from cablesense_online.samples import SampleError


def qos_profile(qos: Qos) -> QoSProfile:
    """A new profile: rclpy writes overrides into the one it is given."""
    durable = qos.transient_local
    reliable = qos.reliable
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


def overridable(topic: str, qos: Qos) -> dict[str, Any]:
    """Keywords of a publisher or subscription: this quality, open to parameters for a stream.

    `qos_overrides.<topic>.<publisher|subscription>.<depth|reliability>` are the parameters of
    `cable_tensions` and `~/wrench`, because networks lose messages and processes pause.
    """
    keywords: dict[str, Any] = {"qos_profile": qos_profile(qos)}
    if topic in (topics.CABLE_TENSIONS, topics.WRENCH):
        policies = QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY
        keywords["qos_overriding_options"] = QoSOverridingOptions(policies)
    return keywords


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


def steady_timer(node: Node, period_s: float, act: Callable[[], None]) -> Timer:
    """A timer in real time, which continues when simulated time stops."""
    return node.create_timer(period_s, act, clock=Clock(clock_type=ClockType.STEADY_TIME))


def serve(node: Node, service: str, act: Callable[[], str]) -> None:
    """A `Trigger` that answers what `act` gives, or why it refuses, which is logged."""

    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.success = True
            response.message = act()
        except CableSenseError as error:
            response.success = False
            response.message = str(error)
            node.get_logger().warning(f"{service.removeprefix('~/')}: {error}")
        return response

    node.create_service(Trigger, service, answer)


class Outputs:
    """The topics of a node, kept for as long as it lives.

    To destroy a publisher while a matched subscriber is being reported ends the process: the
    events executor calls its handler later.
    """

    def __init__(self, node: LifecycleNode) -> None:
        self.node = node
        self._made: dict[str, _Output] = {}

    def make(self, kind: type, topic: str, qos: Qos = PUBLISHER_QOS) -> _Output:
        """The topic, made the first time."""
        if topic not in self._made:
            self._made[topic] = _Output(self.node, kind, topic, qos)
        return self._made[topic]


class _Output:
    """A topic of a node, and whether anyone subscribes: to ask that takes longer than a sum."""

    def __init__(self, node: LifecycleNode, kind: type, topic: str, qos: Qos) -> None:
        self.subscribed = False
        self.publisher: LifecyclePublisher = node.create_lifecycle_publisher(
            kind,
            topic,
            **overridable(topic, qos),
            event_callbacks=PublisherEventCallbacks(matched=self._matched),
        )
        self.publish = self.publisher.publish

    def _matched(self, event: QoSPublisherMatchedInfo) -> None:
        self.subscribed = event.current_count > 0


_TURN_S = 0.05
"""For messages that come without a pause; then commands and timers have theirs."""


def subscribe_to_one(
    node: Node,
    kind: type,
    topic: str,
    qos: Qos,
    publisher: FollowedPublisher,
    take: Callable[[bytes], object],
    refuse: Callable[[SampleError], object],
    accept: Callable[[int, float], bool] | None = None,
    turn_s: float = _TURN_S,
    **events: Callable[[Any], None],
) -> Subscription:
    """A raw subscription: `take` gets the messages of one publisher, never of two in turn.

    `refuse` gets why a message of another is not used. `accept` stands in place of
    `publisher.accept`, which it calls. `events` are callbacks by the names of rclpy.
    """

    def take_each(messages: Sequence[bytes]) -> None:
        for message in messages:
            take(message)

    return subscribe_to_those_waiting(
        node, kind, topic, qos, publisher, take_each, refuse, 1, accept, turn_s, **events
    )


def subscribe_to_those_waiting(
    node: Node,
    kind: type,
    topic: str,
    qos: Qos,
    publisher: FollowedPublisher,
    take: Callable[[Sequence[bytes]], object],
    refuse: Callable[[SampleError], object],
    most_together: int,
    accept: Callable[[int, float], bool] | None = None,
    turn_s: float = _TURN_S,
    **events: Callable[[Any], None],
) -> Subscription:
    """As `subscribe_to_one`, where `take` gets those that wait, up to `most_together` at once.

    The events executor of rclpy gives messages until there are none. Where they come faster than
    `take` is done with them, nothing else would ever run: no command, no service, no timer, not
    even the end of the process. So those that wait after `turn_s` are left out.
    """
    accept = accept or publisher.accept

    def is_accepted(information: Any) -> bool:
        try:
            another = accept(information["publication_sequence_number"], time.monotonic())
        except SampleError as problem:
            refuse(problem)
            return False
        if another:
            node.get_logger().warning(
                f"{topic}: messages of another publisher, or of one of several, are used from "
                "now on",
                throttle_duration_sec=WARN_EVERY_S,
            )
        return True

    def receive(message: Any, information: Any = None) -> None:
        if information is None:  # the events executor of rclpy 7.1 gives both as one tuple
            message, information = message
        turn_ends_s = time.monotonic() + turn_s
        waiting: tuple[bytes, Any] | None = (message, information)
        while waiting:
            together: list[bytes] = []
            while waiting and len(together) < most_together:
                message, information = waiting
                if time.monotonic() < turn_ends_s and is_accepted(information):
                    together.append(message)
                waiting = _waiting(subscription)
            if together:
                take(together)

    # rclpy looks at the signature for whether information is wanted
    receive.__signature__ = Signature(  # type: ignore[attr-defined]
        [Parameter(name, Parameter.POSITIONAL_ONLY) for name in ("message", "information")]
    )
    subscription = node.create_subscription(
        kind,
        topic,
        receive,
        **overridable(topic, qos),
        raw=True,
        event_callbacks=SubscriptionEventCallbacks(
            matched=lambda event: publisher.matched(event.current_count), **events
        ),
    )
    return subscription


def _waiting(subscription: Subscription) -> tuple[bytes, Any] | None:
    """The next message that waits, with its information; None where none does."""
    with subscription.handle:
        taken: tuple[bytes, Any] | None = subscription.handle.take_message(
            subscription.msg_type, subscription.raw
        )
    return taken


WARN_EVERY_S = 1.0
"""At most one warning of a kind in this time; diagnostics count all of them."""


class RefusalLog:
    """Warns of refused messages, at most once in `WARN_EVERY_S` for a topic and kind of error.

    rclpy throttles all warnings of one line of code together, so that one kind would hide another.
    """

    def __init__(self, node: Node, what: str = "message refused") -> None:
        self._node = node
        self._what = what
        self._logged_s: dict[tuple[str, object], float] = {}
        self.count = 0

    def __call__(self, topic: str, error: CableSenseError) -> None:
        """Count it, and warn."""
        self.count += 1
        kind = (topic, getattr(error, "kind", type(error)))
        now_s = time.monotonic()
        if now_s - self._logged_s.get(kind, -math.inf) >= WARN_EVERY_S:
            self._logged_s[kind] = now_s
            self._node.get_logger().warning(f"{topic}: {self._what}: {error}")

    def subscribe(
        self,
        kind: type,
        topic: str,
        qos: Qos,
        handle: Callable[[Any], object],
        publisher: FollowedPublisher | None = None,
        accept: Callable[[int, float], bool] | None = None,
    ) -> Subscription:
        """A subscription that refuses what `handle` raises a `CableSenseError` for.

        A message that is too long is never parsed. With a `publisher` to follow, messages of
        others are refused (`subscribe_to_one`).
        """
        is_calibration = topic in (topics.CALIBRATION, topics.CALIBRATION_USED)
        most_bytes = MAX_CALIBRATION_BYTES if is_calibration else MAX_MESSAGE_BYTES

        def take(raw: bytes) -> None:
            try:
                require_bounded(raw, most_bytes)
                try:
                    message = deserialize_message(raw, kind)
                except Exception as error:  # of the middleware, each its own
                    raise ContractError(f"no message of its type ({error})") from error
                handle(message)
            except CableSenseError as error:
                self(topic, error)

        if publisher is None:
            return self._node.create_subscription(kind, topic, take, qos_profile(qos), raw=True)
        refuse = partial(self, topic)
        return subscribe_to_one(self._node, kind, topic, qos, publisher, take, refuse, accept)


TRAJECTORY_PERIOD_S = 0.02
"""From one command of a trajectory to the next."""


class CommandInput:
    """The joint commands of a node: those on `joint_commands`, and those of a `JointTrajectory`.

    A trajectory is interpolated linearly into a command every 20 ms, from the present one on where
    its first point is later. It replaces the one before; one without points stops that, as
    trajectory controllers have it.
    """

    def __init__(
        self,
        node: Node,
        refuse: RefusalLog,
        joint_names: Sequence[str],
        present_rad: Callable[[], Array],
        take: Callable[[JointState], object],
        topic: str = topics.JOINT_COMMANDS,
    ) -> None:
        """`take` gets the commands, `present_rad` gives the one in force (2N,).

        `topic` is another one where measured joint positions stand for commands.
        """
        self._node = node
        self._refuse = refuse
        self._take = take
        self._joint_names = list(joint_names)
        self._present_rad = present_rad
        self._command = JointState()
        self._times_s: Array = np.zeros(0)
        self._positions_rad: Array = np.zeros((0, 0))
        self._start_s = 0.0
        self._subscriptions = [
            refuse.subscribe(JointState, topic, COMMAND_QOS, take),
            refuse.subscribe(JointTrajectory, topics.JOINT_TRAJECTORY, COMMAND_QOS, self._begin),
        ]
        self._timer = steady_timer(node, TRAJECTORY_PERIOD_S, self._follow)

    def destroy(self) -> None:
        """Take no more."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._node.destroy_timer(self._timer)

    def _begin(self, message: JointTrajectory) -> None:
        names = list(message.joint_names)
        points = message.points
        for point in points:
            if len(point.positions) != len(names):
                raise ContractError(
                    f"points: {len(point.positions)} positions for {len(names)} joint names"
                )
        since = [point.time_from_start for point in points]
        times_s: Array = np.array([duration.sec + 1e-9 * duration.nanosec for duration in since])
        positions_rad: Array = np.array([point.positions for point in points])
        if len(points) and (times_s[0] < 0.0 or (np.diff(times_s) <= 0.0).any()):
            raise ContractError("points: time_from_start must ascend, from 0 on")
        if len(points) and times_s[0] > 0.0:
            present = dict(zip(self._joint_names, self._present_rad(), strict=True))
            first = dict(zip(names, positions_rad[0], strict=True)) | present
            times_s = np.insert(times_s, 0, 0.0)
            positions_rad = np.vstack([[first[name] for name in names], positions_rad])
        stamp = message.header.stamp
        now_ns = self._node.get_clock().now().nanoseconds
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        late_s = (now_ns - stamp_ns) * 1e-9 if stamp_ns else 0.0
        self._start_s = time.monotonic() - late_s
        self._command.name = names
        self._times_s = times_s
        self._positions_rad = positions_rad

    def _follow(self) -> None:
        passed_s = time.monotonic() - self._start_s
        if not len(self._times_s) or passed_s < 0.0:
            return
        columns = self._positions_rad.T
        self._command.position = [np.interp(passed_s, self._times_s, column) for column in columns]
        if passed_s >= self._times_s[-1]:
            self._times_s = np.zeros(0)
        try:
            self._take(self._command)
        except CableSenseError as error:
            self._times_s = np.zeros(0)
            self._refuse(topics.JOINT_TRAJECTORY, error)
