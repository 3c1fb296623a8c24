"""The contract's topics in rclpy's terms: quality of service, subscriptions, refusals."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from inspect import Parameter, Signature
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
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
from rclpy.subscription import Subscription

from cablesense_base import CableSenseError
from cablesense_msgs_py.qos import Qos
from cablesense_msgs_py.serialized import require_bounded
from cablesense_msgs_py.topics import ContractError
from cablesense_online.samples import FollowedPublisher, SampleError


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
