"""Records from running nodes: topics into an MCAP file, tensions for a check of sensors."""

from __future__ import annotations

import signal
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from rich.console import Console
from sensor_msgs.msg import JointState

from cablesense_base import CableSenseError
from cablesense_base.progress import status
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import NamedOrder
from cablesense_msgs_py.qos import INPUTS, SENSOR_QOS, TopicType, resolved, segment_of
from cablesense_online.followed_publisher import FollowedPublisher
from cablesense_online.sensor_check import CommissioningError, Pull
from cablesense_recording.mcap_file import BagRows
from cablesense_recording.mcap_messages import CHUNK_S, TopicFile, topic_file_path
from cablesense_recording.recording import Recording, RecordingError
from cablesense_ros.endpoints import RefusalLog, message_class, qos_profile, subscribe_to_one
from cablesense_ros.node_process import spun_node
from cablesense_ros.processes import end_signals
from cablesense_sim.arm import Arm

_TURN_S = 1.0
"""For which samples are written that come without a pause; what then waits is lost."""
_COUNTED = (topics.CABLE_TENSIONS, topics.JOINT_COMMANDS, topics.APPLIED_WRENCH, topics.WRENCH)


class Recorder:
    """Subscribes a node to topics of the contract, and writes what comes until it is closed.

    The file grows chunk by chunk; a recorder that is killed leaves all but its last one. Tensions
    of a second publisher are logged and left out, with an arm all inputs that break its contract.
    """

    def __init__(
        self,
        node: Node,
        path: str | Path,
        wanted: Mapping[str, TopicType],
        arm: Arm | None,
        force: bool = False,
    ) -> None:
        """Listen in the node's namespace; topics of a type that is not installed are left out.

        Raises:
            RecordingError: the file exists already and `force` does not replace it, or it cannot
                be written.
        """
        self._file = TopicFile(path, force)
        self._node = node
        self._wanted = wanted
        self._contract = None if arm is None else BagRows(arm, keep=False)
        self._channels: dict[str, Any] = {}
        self._names: set[str] = set()
        self._started_s = time.monotonic()
        self._flushed_s = self._started_s
        self._failure: RecordingError | None = None
        self.counts: Counter[str] = Counter()
        self._left_out: Counter[str] = Counter()
        self._log = RefusalLog(node, "left out")
        for topic in wanted:
            if topic != topics.SEGMENT_WRENCHES:  # only an estimator that is there says how many
                self._subscribe(topic, resolved(topic, node.get_namespace()))

    @property
    def status(self) -> str:
        """One line: how long, and how much of what."""
        parts = [f"{time.monotonic() - self._started_s:.0f} s"]
        for topic in filter(self._wanted.__contains__, _COUNTED):
            left_out = f" ({n} left out)" if (n := self._left_out[topic]) else ""
            parts.append(f"{topic} {self.counts[topic] or 'nothing yet'}{left_out}")
        return " · ".join(parts)

    def flush(self) -> None:
        """To be called several times a second: what came goes out, also when nothing follows it.

        Raises:
            RecordingError: the file cannot be written any more.
        """
        if self._failure is not None:
            raise self._failure
        now_s = time.monotonic()
        if now_s - self._flushed_s >= CHUNK_S:
            self._file.flush()
            self._flushed_s = now_s
            self._subscribe_to_segments()

    def close(self) -> None:
        """Finish the file.

        Raises:
            RecordingError: nothing worth a file came, or it cannot be written.
        """
        if self.counts[topics.CABLE_TENSIONS]:
            self._file.close()
            return
        self._file.discard()
        took_s = time.monotonic() - self._started_s
        raise RecordingError(
            f"nothing on {topics.CABLE_TENSIONS} in {took_s:.0f} s, and so no file; is the arm's "
            "driver or the sim node running, in this ROS_DOMAIN_ID and namespace?"
        )

    def _subscribe_to_segments(self) -> None:
        if topics.SEGMENT_WRENCHES not in self._wanted:
            return
        of_this_arm = resolved(topics.SEGMENT_WRENCHES, self._node.get_namespace())
        for name, _ in self._node.get_topic_names_and_types():
            if name == of_this_arm.format(segment_of(name)) and name not in self._names:
                self._subscribe(topics.SEGMENT_WRENCHES, name)

    def _subscribe(self, topic: str, name: str) -> None:
        """To a topic of the contract by its full name, where its message type is installed."""
        of = self._wanted[topic]
        node = self._node
        kind = message_class(of.kind)
        self._names.add(name)
        if kind is None:
            return
        take = partial(self._take, topic, name, kind)
        if topic == topics.CABLE_TENSIONS:
            refuse = partial(self._leave_out, topic)
            publisher = FollowedPublisher()
            subscribe_to_one(
                node, kind, name, of.requested, publisher, take, refuse, turn_s=_TURN_S
            )
        else:
            node.create_subscription(kind, name, take, qos_profile(of.requested), raw=True)

    def _take(self, topic: str, name: str, kind: type, raw: bytes) -> None:
        if self._failure is not None:
            return
        now_ns = time.time_ns()
        try:
            if self._contract is not None and topic in INPUTS:
                self._contract.take(topic, now_ns, deserialize_message(raw, kind))
        except CableSenseError as error:
            self._leave_out(topic, error)
            return
        try:
            if name not in self._channels:
                of = self._wanted[topic]
                self._channels[name] = self._file.add(name, of.kind, of.offered)
            self._file.write(self._channels[name], now_ns, raw)
        except RecordingError as error:  # an executor would print where it comes from
            self._failure = error
        self.counts[topic] += 1

    def _leave_out(self, topic: str, error: CableSenseError) -> None:
        self._left_out[topic] += 1
        self._log(topic, error)


_WAKE_S = 0.25
"""How often a wait looks whether it is to end."""


def record_topics(
    path: Path,
    wanted: Mapping[str, TopicType],
    duration_s: float | None,
    arm: Arm | None,
    console: Console,
    namespace: str = "",
    force: bool = False,
) -> None:
    """Record nodes of a namespace, into a whole file, until `duration_s` have passed or a signal.

    Raises:
        RecordingError: the file exists, cannot be written, or no tensions came.
    """
    wanted_end = Future()
    topic_file_path(path, force)  # refused before a node starts
    with (
        end_signals(lambda *_: wanted_end.set_result(None)),
        spun_node("recorder", namespace) as (node, executor),
    ):
        recorder = Recorder(node, path, wanted, arm, force)
        end_s = float("inf") if duration_s is None else time.monotonic() + duration_s
        try:
            with status("waiting for the arm") as say:
                while not wanted_end.done() and (left_s := end_s - time.monotonic()) > 0.0:
                    wake_s = min(_WAKE_S, left_s)
                    executor.spin_until_future_complete(wanted_end, timeout_sec=wake_s)
                    recorder.flush()
                    say(f"recording, Ctrl-C ends it: {recorder.status}")
        finally:
            recorder.close()
        console.print(f"{path}: {recorder.status}", soft_wrap=True, markup=False, highlight=False)


_FIRST_SAMPLE_S = 5.0
"""How long the first sample is waited for."""
_JOINING_S = 0.5
"""After the first sample. Some are lost while subscriber and publisher discover each other."""
_PULLING_S = 3.0
"""How long a cable is to be pulled."""
_RELEASED_S = 3.0
"""How long it is left alone thereafter."""
_LISTEN_S = 0.1
"""Ctrl-C takes effect within this time."""


def capture_tensions(
    cable_names: Sequence[str],
    rest_s: float,
    pulled: Sequence[str],
    say: Callable[[str], object],
    namespace: str = "",
) -> tuple[Recording, list[Pull]]:
    """Readings at rest, then while a person pulls the `pulled` cables in turn as `say` asks.

    Columns are in the order of `cable_names`; times are stamps, or of arrival if there are none.

    Raises:
        CommissioningError: nothing comes, two nodes publish, a reading is not finite, or stamps
            do not ascend.
        ContractError: messages break the contract.
    """
    order = NamedOrder(cable_names, "cables")
    times_s: list[float] = []
    tensions_n: list[tuple[float, ...]] = []
    errors: list[CableSenseError] = []

    def take(message: JointState) -> None:
        """Keep an error for the caller, because the executor would drop it."""
        try:
            tensions_n.append(order.pick(message.name, message.effort, "effort"))
        except CableSenseError as error:
            errors.append(error)
            return
        stamp = message.header.stamp
        times_s.append(stamp.sec + 1e-9 * stamp.nanosec or time.time())

    with spun_node("sensor_check", namespace) as (node, executor):

        def wait(seconds: float) -> None:
            end_s = time.monotonic() + seconds
            while (left_s := end_s - time.monotonic()) > 0.0:
                _spin(executor, min(left_s, _LISTEN_S))
                if errors:
                    raise errors[0]

        def latest_s() -> float:
            if not times_s:
                raise CommissioningError(
                    f"{topics.CABLE_TENSIONS} stopped; its driver's diagnostics give the reason"
                )
            return times_s[-1]

        node.create_subscription(JointState, topics.CABLE_TENSIONS, take, qos_profile(SENSOR_QOS))
        end_s = time.monotonic() + _FIRST_SAMPLE_S
        while not times_s and time.monotonic() < end_s:
            wait(_LISTEN_S)
        if not times_s:
            raise CommissioningError(
                f"nothing on {topics.CABLE_TENSIONS} in {_FIRST_SAMPLE_S:g} s: is the driver "
                "running and active, in this ROS_DOMAIN_ID and namespace?"
            )
        wait(_JOINING_S)
        if node.count_publishers(topics.CABLE_TENSIONS) > 1:
            raise CommissioningError(f"{topics.CABLE_TENSIONS} has two publishers; stop one")
        times_s.clear()
        tensions_n.clear()
        say(f"leave the arm alone for {rest_s:g} s")
        wait(rest_s)
        pulls = []
        for cable in pulled:
            start_s = latest_s()
            say(f"pull {cable} by hand and hold it, sideways, near its sensor")
            wait(_PULLING_S)
            pulls.append(Pull(cable, start_s - times_s[0], latest_s() - times_s[0]))
            say("let go")
            wait(_RELEASED_S)
        latest_s()
    time_s = np.array(times_s)
    read_n = np.array(tensions_n)
    if not np.isfinite(read_n).all() or (np.diff(time_s) <= 0.0).any():
        raise CommissioningError(
            f"{topics.CABLE_TENSIONS} has readings that are not finite, or stamps that do not "
            "ascend; its driver's diagnostics give the cause"
        )
    zeros = np.zeros(len(time_s), dtype=np.int64)
    nowhere = np.zeros((len(time_s), 3))
    name = topics.CABLE_TENSIONS
    return Recording(name, time_s - time_s[0], zeros, nowhere, zeros, nowhere, read_n), pulls


def _spin(executor: Executor, seconds: float) -> None:
    """Spin for a time; a signal to end takes effect after it.

    What a handler raises while the executor hands an argument to Python would be lost.
    """
    wanted_end = Future()
    with end_signals(lambda number, _: wanted_end.set_result(number)):
        executor.spin_until_future_complete(wanted_end, timeout_sec=seconds)
    if wanted_end.done():
        signal.raise_signal(wanted_end.result())
