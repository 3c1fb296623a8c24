"""A recording from start to Ctrl-C: the node, its executor, and what people see meanwhile."""

from __future__ import annotations

import signal
import time
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path

import rclpy
import rclpy.utilities
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rich.console import Console

from cablesense_msgs_py.topic_types import TopicType
from cablesense_ros.discovery import prefer_quick_discovery
from cablesense_ros.recorder import Recorder
from cablesense_sim.arm import Arm

_WAKE_S = 0.25


def record_topics(
    path: Path,
    wanted: Mapping[str, TopicType],
    duration_s: float | None,
    arm: Arm | None,
    console: Console,
    namespace: str = "",
) -> None:
    """Record until `duration_s` have passed, SIGINT or SIGTERM; the file is whole then.

    Args:
        path: of the file.
        wanted: topics of the contract.
        duration_s: how long, or until a signal.
        arm: whose contract is checked, if any.
        console: for people.
        namespace: of the nodes to listen to.

    Raises:
        RecordingError: the file exists, cannot be written, or no tensions came.
    """
    say = partial(console.print, soft_wrap=True, markup=False, highlight=False)
    wanted_end = Future()
    before = {
        number: signal.signal(number, lambda *_: wanted_end.set_result(None))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    prefer_quick_discovery()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("recorder", namespace=namespace or None)
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        recorder = Recorder(node, path, wanted, arm, say)
        try:
            _spin(executor, recorder, wanted_end, duration_s, console)
        finally:
            recorder.close()
        say(f"{path}: {recorder.status}")
    finally:
        executor.shutdown()
        node.destroy_node()
        with suppress(RuntimeError):
            rclpy.utilities.try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)


def _spin(
    executor: EventsExecutor,
    recorder: Recorder,
    wanted_end: Future,
    duration_s: float | None,
    console: Console,
) -> None:
    end_s = float("inf") if duration_s is None else time.monotonic() + duration_s
    with console.status("waiting for the arm") as line:
        while not wanted_end.done() and (left_s := end_s - time.monotonic()) > 0.0:
            executor.spin_until_future_complete(wanted_end, timeout_sec=min(_WAKE_S, left_s))
            recorder.flush()
            recorder.hint_at_silence()
            line.update(f"recording, Ctrl-C ends it: {recorder.status}")
