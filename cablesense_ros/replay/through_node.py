"""A recorded run through an estimator node that runs: inputs out, answers in, compared."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import NamedTuple

import rclpy
import rclpy.utilities
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from cablesense_msgs_py import topics
from cablesense_msgs_py.journal import EventKind, JournalEntry
from cablesense_msgs_py.stamped_bytes import restamped
from cablesense_ros.discovery import prefer_quick_discovery
from cablesense_ros.replay.comparison import Comparison
from cablesense_ros.replay.live_estimator import LiveEstimator
from cablesense_ros.replay.recorded_run import RecordedRun, Step

LONGEST_AGE_NS = 10_000_000
"""Samples keep the age that they had when recorded, up to this: a recorder's clock may be off."""

PATIENT_S = "10.0"
MOST_OPEN = 200
"""Samples on the way to an answer; the estimator keeps 500 in its queue."""

_SETTLE_S = 0.5
_WAKE_S = 0.2
_SERVICES = {EventKind.TARE: topics.TARE, EventKind.TARE_UNDO: topics.TARE_UNDO}
_REPEATED = {EventKind.COMMAND, EventKind.SETTINGS, *_SERVICES}


def replay_through_node(
    run: RecordedRun, rate: float, namespace: str, say: Callable[[str], object]
) -> Comparison:
    """Publish what the recorded estimator took, at the recorded pace, and compare the answers.

    Every stamp is shifted by the same time, so that the first sample is one of now; at another
    rate the time between stamps shrinks with it. Commands and tares go where the journal has them:
    after the answer to the sample before, and before the next sample. The estimator must have been
    started afresh, for it to be in the state that the recorded one was in at its start.

    Args:
        run: the recording.
        rate: how many times as fast as recorded.
        namespace: of the estimator.
        say: takes a line for people.

    Raises:
        RecordingError: no estimator listens, or it refuses a tare that is in the recording.
    """
    with _spinning_node() as node:
        live = LiveEstimator(node, namespace)
        live.wait_until_there()
        time.sleep(_SETTLE_S)  # that the estimator knows of this node as well
        return _Player(run, rate, live, say).play()


@contextmanager
def _spinning_node() -> Iterator[Node]:
    prefer_quick_discovery()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("replay")
    executor, end = EventsExecutor(), Future()
    executor.add_node(node)

    def spin() -> None:
        while not end.done():
            executor.spin_until_future_complete(end, timeout_sec=_WAKE_S)

    thread = threading.Thread(target=spin, name="answers")
    thread.start()
    try:
        yield node
    finally:
        end.set_result(None)
        thread.join()
        executor.shutdown()
        node.destroy_node()
        with suppress(RuntimeError):
            rclpy.utilities.try_shutdown()


class _Open(NamedTuple):
    """A sample that was sent and is not compared yet: its number, its stamps and its answer."""

    number: int
    stamp_ns: int
    recorded_ns: int
    recorded: bytes


class _Player:
    """Walks through the recording once."""

    def __init__(
        self, run: RecordedRun, rate: float, live: LiveEstimator, say: Callable[[str], object]
    ) -> None:
        self._run, self._rate, self._live, self._say = run, rate, live, say
        self._comparison = Comparison()
        self._others = deque(run.other_inputs)
        self._open: deque[_Open] = deque()
        self._begun = self._sent = False
        self._first_log_ns = self._first_stamp_ns = 0
        self._start_s, self._start_ns = 0.0, 0

    def play(self) -> Comparison:
        """Publish and compare everything."""
        counts = self._comparison
        entries: list[JournalEntry] = []
        for step in self._run.steps():
            counts.samples += 1
            entries += step.entries
            if self._run.has_answers and step.pair.answer is None:
                counts.unanswered += 1
                if not step.taken:
                    continue
            if not self._begun:
                self._begin(step)
            self._pace(step.pair.log_ns)
            for entry in entries:
                self._repeat(entry)
            entries = []
            stamp_ns = self._shifted(step.pair.stamp_ns)
            self._sent = True
            self._live.publish(topics.CABLE_TENSIONS, restamped(step.pair.sample, stamp_ns))
            if step.pair.answer is not None:
                self._open.append(
                    _Open(counts.samples, stamp_ns, step.pair.stamp_ns, step.pair.answer)
                )
            if len(self._open) > MOST_OPEN:
                self._live.wait_for(self._open[0].stamp_ns)
            self._compare()
        self._await_answers()
        self._compare(to_the_end=True)
        if self._run.entries:
            self._live.adjust(self._run.entries[-1].settings)
        pairs = self._run.pairs
        counts.unstamped, counts.lone_contacts = pairs.unstamped, pairs.lone_contacts
        counts.lone_zeros = pairs.lone_zeros
        return counts

    def _begin(self, step: Step) -> None:
        self._begun = True
        entries = self._run.entries
        if entries:
            self._adjust(entries[0])
            if not any(event.kind is EventKind.START for event in entries[0].events):
                self._say(
                    "the recording begins after its estimator, so the tare before is not in it; "
                    "the estimator that runs takes its own"
                )
                self._live.command(self._run.joint_names, entries[0].command_rad)
        else:
            self._say("no ~/journal in the recording: commands go as they came, tares not at all")
        self._first_log_ns, self._first_stamp_ns = step.pair.log_ns, step.pair.stamp_ns
        age_ns = min(max(step.pair.log_ns - step.pair.stamp_ns, 0), LONGEST_AGE_NS)
        self._start_s, self._start_ns = time.monotonic(), time.time_ns() - age_ns

    def _adjust(self, entry: JournalEntry) -> None:
        """As recorded, but patient: a busy machine must not make a replay's samples stale."""
        self._live.adjust({**entry.settings, "stale_after_s": PATIENT_S})

    def _pace(self, log_ns: int) -> None:
        """Wait for a sample's turn; what else came before it goes out before it."""
        while self._others and self._others[0].log_ns <= log_ns:
            other = self._others.popleft()
            self._sleep_until(other.log_ns)
            self._live.publish(other.topic, other.data)
        self._sleep_until(log_ns)

    def _sleep_until(self, log_ns: int) -> None:
        due_s = self._start_s + (log_ns - self._first_log_ns) * 1e-9 / self._rate
        wait_s = due_s - time.monotonic()
        if wait_s > 0.0:
            time.sleep(wait_s)

    def _shifted(self, stamp_ns: int) -> int:
        since_ns = stamp_ns - self._first_stamp_ns
        return self._start_ns + (since_ns if self._rate == 1.0 else round(since_ns / self._rate))

    def _repeat(self, entry: JournalEntry) -> None:
        """Between the sample before and the next one, as when recorded."""
        if any(event.kind in _REPEATED for event in entry.events):
            self._await_answers()
        for event in entry.events:
            if event.kind is EventKind.COMMAND:
                self._live.command(self._run.joint_names, event.command_rad)
            elif event.kind in _SERVICES:
                self._live.call(_SERVICES[event.kind])
            elif event.kind is EventKind.SETTINGS:
                self._adjust(entry)
            elif event.kind is EventKind.START and self._sent:
                self._say("the recorded estimator was started anew here; the one that runs is not")

    def _await_answers(self) -> None:
        if self._open:
            self._live.wait_for(self._open[-1].stamp_ns)

    def _compare(self, to_the_end: bool = False) -> None:
        answers = self._live.answers
        while self._open and (
            to_the_end
            or self._open[0].stamp_ns in answers
            or len(self._open) > MOST_OPEN  # it was waited for in vain
        ):
            number, stamp_ns, recorded_ns, recorded = self._open.popleft()
            answer = answers.pop(stamp_ns, None)
            replayed = None if answer is None else restamped(answer, recorded_ns)
            self._comparison.compare(number, recorded, replayed)
