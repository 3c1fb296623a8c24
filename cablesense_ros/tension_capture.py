"""Tensions of a running arm for some seconds, and while a person pulls its cables."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from rclpy.task import Future
from sensor_msgs.msg import JointState

from cablesense_msgs_py import qos, topics
from cablesense_msgs_py.messages import NamedOrder
from cablesense_msgs_py.serialized import EffortReader
from cablesense_online.commissioning.sensor_statistics import TensionSeries
from cablesense_online.commissioning.tables import CommissioningError, Pull, TimeWindow
from cablesense_online.samples import FollowedPublisher, SampleError
from cablesense_ros.endpoints import subscribe_to_one
from cablesense_ros.node_process import spun_node

_FIRST_SAMPLE_S = 5.0
_JOINING_S = 0.5
"""After the first sample; some are lost while subscriber and publisher find each other."""
_PULLING_S, _RELEASED_S = 3.0, 3.0
_WAKE_S = 0.1
"""Ctrl-C takes effect within this time."""


def capture_tensions(
    cable_names: Sequence[str],
    rest_s: float,
    pulled: Sequence[str],
    say: Callable[[str], object],
    namespace: str = "",
) -> tuple[TensionSeries, list[Pull]]:
    """Readings at rest, then while a person pulls one cable after another as `say` asks.

    Args:
        cable_names: (M,) in the order wanted.
        rest_s: how long the arm is left alone first.
        pulled: cables to pull, in this order.
        say: takes a line for the person.
        namespace: of the arm's nodes.

    Raises:
        CommissioningError: nothing comes, or two publish.
        ContractError: messages break the contract.
    """
    samples, never = _Samples(cable_names), Future()
    with spun_node("sensor_check", namespace) as (node, executor):

        def wait(seconds: float) -> None:
            end_s = time.monotonic() + seconds
            while (left_s := end_s - time.monotonic()) > 0.0:
                executor.spin_until_future_complete(never, timeout_sec=min(left_s, _WAKE_S))
                if samples.error is not None:
                    raise samples.error

        subscribe_to_one(
            node,
            JointState,
            topics.CABLE_TENSIONS,
            qos.SENSOR,
            FollowedPublisher(),
            samples.take,
            samples.refuse,
        )
        end_s = time.monotonic() + _FIRST_SAMPLE_S
        while not samples.times_s and time.monotonic() < end_s:
            wait(_WAKE_S)
        if not samples.times_s:
            raise CommissioningError(
                f"nothing on {topics.CABLE_TENSIONS} in {_FIRST_SAMPLE_S:g} s: is the driver "
                "running and active, in this ROS_DOMAIN_ID and namespace?"
            )
        wait(_JOINING_S)
        samples.forget()
        say(f"leave the arm alone for {rest_s:g} s")
        wait(rest_s)
        pulls = []
        for cable in pulled:
            start_s = samples.latest_s
            say(f"pull {cable} by hand and hold it, sideways, near its sensor")
            wait(_PULLING_S)
            pulls.append(Pull(cable, TimeWindow(start_s, samples.latest_s)))
            say("let go")
            wait(_RELEASED_S)
        return samples.series(), pulls


class _Samples:
    """What came; times count from the first sample, by its stamp or else its arrival."""

    def __init__(self, cable_names: Sequence[str]) -> None:
        self._order = NamedOrder(cable_names, "cables")
        self._reader = EffortReader()
        self.error: Exception | None = None
        self.forget()

    def forget(self) -> None:
        self._start_s: float | None = None
        self._backward = self._broken = 0
        self.times_s: list[float] = []
        self.tensions_n: list[tuple[float, ...]] = []

    @property
    def latest_s(self) -> float:
        if not self.times_s:
            raise CommissioningError(
                f"{topics.CABLE_TENSIONS} stopped; its driver's diagnostics give the reason"
            )
        return self.times_s[-1]

    def refuse(self, problem: SampleError) -> None:
        self.error = CommissioningError(f"{topics.CABLE_TENSIONS} has two publishers: {problem}")

    def take(self, raw: bytes) -> None:
        """In the executor, which would drop an exception: it is kept for the caller."""
        try:
            sample = self._reader.read(raw)
            tensions_n = self._order.pick(sample.names, sample.values, "effort")
        except Exception as error:
            self.error = error
            return
        stamp_s = (sample.stamp_ns or time.time_ns()) * 1e-9
        if self._start_s is None:
            self._start_s = stamp_s
        since_s = stamp_s - self._start_s
        if not np.isfinite(tensions_n).all():
            self._broken += 1
        elif self.times_s and since_s <= self.latest_s:
            self._backward += 1
        else:
            self.times_s.append(since_s)
            self.tensions_n.append(tensions_n)

    def series(self) -> TensionSeries:
        problems = (
            (self._broken, "were not finite; every reading must be"),
            (
                self._backward,
                "came with a stamp not after the last; each must be later: is there a second "
                "publisher?",
            ),
        )
        times_s = np.array([*self.times_s[:-1], self.latest_s])
        return TensionSeries(
            self._order.names,
            times_s,
            np.zeros(len(times_s), dtype=np.int64),
            np.ones(len(times_s), dtype=bool),
            np.array(self.tensions_n),
            tuple(f"{count} samples {text}" for count, text in problems if count),
        )
