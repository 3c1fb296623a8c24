"""Tensions of a running arm for some seconds, and while a person pulls its cables."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence

import numpy as np
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.task import Future
from sensor_msgs.msg import JointState

from cablesense_base import CableSenseError
from cablesense_msgs_py import qos, topics
from cablesense_msgs_py.messages import NamedOrder
from cablesense_online.commissioning import CommissioningError
from cablesense_online.commissioning.sensor_check import Pull, TensionSeries
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.node_process import spun_node
from cablesense_ros.processes import end_signals

_FIRST_SAMPLE_S = 5.0
_JOINING_S = 0.5
"""After the first sample. Some are lost while subscriber and publisher discover each other."""
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
    """Readings at rest, then while a person pulls the `pulled` cables in turn as `say` asks.

    Columns are in the order of `cable_names`. Times are those of the samples' stamps, or of
    arrival if they have none.

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
                _spin(executor, min(left_s, _WAKE_S))
                if errors:
                    raise errors[0]

        def latest_s() -> float:
            if not times_s:
                raise CommissioningError(
                    f"{topics.CABLE_TENSIONS} stopped; its driver's diagnostics give the reason"
                )
            return times_s[-1]

        node.create_subscription(JointState, topics.CABLE_TENSIONS, take, qos_profile(qos.SENSOR))
        end_s = time.monotonic() + _FIRST_SAMPLE_S
        while not times_s and time.monotonic() < end_s:
            wait(_WAKE_S)
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
    time_s, read_n = np.array(times_s), np.array(tensions_n)
    if not np.isfinite(read_n).all() or (np.diff(time_s) <= 0.0).any():
        raise CommissioningError(
            f"{topics.CABLE_TENSIONS} has readings that are not finite, or stamps that do not "
            "ascend; its driver's diagnostics give the cause"
        )
    block, at_rest = np.zeros(len(time_s), dtype=np.int64), np.ones(len(time_s), dtype=bool)
    return TensionSeries(order.names, time_s - time_s[0], block, at_rest, read_n), pulls


def _spin(executor: EventsExecutor, seconds: float) -> None:
    """Spin for a time; a signal to end takes effect after it.

    An exception that a handler raises while the executor hands an argument to Python is lost.
    """
    wanted_end = Future()
    with end_signals(lambda number, _: wanted_end.set_result(number)):
        executor.spin_until_future_complete(wanted_end, timeout_sec=seconds)
    if wanted_end.done():
        signal.raise_signal(wanted_end.result())
