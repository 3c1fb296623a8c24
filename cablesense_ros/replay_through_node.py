"""A recorded run through a running estimator node: inputs out, answers in, compared."""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from cablesense_gap.recordings.recording import RecordingError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import breath_frame
from cablesense_msgs_py.qos import CONTRACT, INPUTS, resolved
from cablesense_msgs_py.serialized import restamped, stamp_ns
from cablesense_online.recorded_run import RecordedRun, Step
from cablesense_online.replay import Comparison, replayed_steps
from cablesense_online.state import LIVE_SETTINGS, EstimatorState, EventKind
from cablesense_ros.endpoints import message_class, qos_profile
from cablesense_ros.node_process import node_in_thread

PATIENCE_S = 10.0
LONGEST_AGE_NS = 10_000_000
"""Samples keep the age that they had when recorded, up to this: a recorder's clock may be off."""

STALE_AFTER_S = 10.0
"""Of the estimator during a replay: a busy machine must not make its samples stale."""

MOST_OPEN = 200
"""Samples on the way to an answer; the estimator keeps 500 in its queue."""

_ANSWER_S = 1.0
_SETTLE_S = 0.5
_POLL_S = 0.0005
_SERVICES = {EventKind.TARE: topics.TARE, EventKind.TARE_UNDO: topics.TARE_UNDO}
_NOT_REPEATED = {EventKind.CLOCK_AHEAD, EventKind.PUBLISHER}
_COMMANDS = {EventKind.COMMAND, EventKind.POSE_CONFIRMED}
_REPEATED = {EventKind.BREATH, EventKind.SETTINGS, *_COMMANDS, *_SERVICES}


def replay_through_node(
    run: RecordedRun, rate: float, namespace: str, report: Callable[[str], object]
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
        report: takes a line of text for the user.

    Raises:
        RecordingError: no estimator listens, or it refuses a tare that is in the recording.
    """
    with node_in_thread("replay") as node:
        live = LiveEstimator(node, namespace, run.segments)
        live.wait_until_there()
        time.sleep(_SETTLE_S)  # until the estimator has discovered this node as well
        return _Player(run, rate, live, report).play()


class LiveEstimator:
    """A running estimator, as a replay uses it; another thread spins the node.

    Attributes:
        answers: by their stamps, as `Step.answers`, until the player removes them.
    """

    def __init__(self, node: Node, namespace: str, segments: Sequence[int]) -> None:
        """`segments` are those whose own wrenches are wanted too."""
        self._node = node
        self._namespace = namespace
        self.answers: defaultdict[int, dict[int, bytes]] = defaultdict(dict)
        self._count = 1 + len(segments)
        self._out = {
            topic: node.create_publisher(
                message_class(INPUTS[topic].kind), self._name(topic), qos_profile(qos.offered)
            )
            for topic, qos in INPUTS.items()
        }
        for number in (0, *segments):
            topic = topics.SEGMENT_WRENCHES.format(number) if number else topics.WRENCH
            node.create_subscription(
                WrenchStamped,
                self._name(topic),
                lambda raw, number=number: self.answers[stamp_ns(raw)].update({number: raw}),
                qos_profile(CONTRACT[topics.WRENCH].requested),
                raw=True,
            )
        self._clients: dict[str, Client] = {
            name: node.create_client(kind, self._name(name))
            for name, kind in (
                ("~/get_parameters", GetParameters),
                ("~/set_parameters", SetParameters),
                (topics.TARE, Trigger),
                (topics.TARE_UNDO, Trigger),
            )
        }

    def wait_until_there(self) -> None:
        """Until an estimator subscribes and publishes.

        Raises:
            RecordingError: none is there within `PATIENCE_S`.
        """
        inputs = [self._out[topic] for topic in (topics.CABLE_TENSIONS, topics.JOINT_COMMANDS)]
        wrench = self._name(topics.WRENCH)

        def there() -> bool:
            taken = all(publisher.get_subscription_count() for publisher in inputs)
            return taken and bool(self._node.count_publishers(wrench))

        if not _until(there, PATIENCE_S):
            raise RecordingError(
                f"no estimator takes {self._name(topics.CABLE_TENSIONS)} and publishes {wrench}; "
                "start one, in this ROS_DOMAIN_ID and namespace"
            )

    def publish(self, topic: str, raw: bytes) -> None:
        """One serialized message on an input topic."""
        self._out[topic].publish(raw)

    def command(
        self, names: Sequence[str], angles_rad: Sequence[float], frame: str = "", stamp: int = 0
    ) -> None:
        """A command, which the estimator has dealt with when this returns."""
        message = JointState(name=list(names), position=list(angles_rad))
        message.header.frame_id = frame
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        self._out[topics.JOINT_COMMANDS].publish(message)
        # the middleware's acknowledgement takes seconds; a question that comes behind the command
        # is answered behind it
        answer = self._clients["~/get_parameters"].call_async(GetParameters.Request())
        _until(answer.done, PATIENCE_S)

    def call(self, service: str) -> None:
        """`~/tare` or `~/tare_undo`, done when this returns.

        Raises:
            RecordingError: the estimator refuses, or does not answer.
        """
        response = self._answer(service, Trigger.Request())
        if not response.success:
            raise RecordingError(
                f"{self._name(service)} refuses what it took when recorded: {response.message}; "
                "was the estimator started afresh?"
            )

    def adjust(self, settings: Any) -> None:
        """Set the parameters that may change while it runs, from attributes of their names.

        Raises:
            RecordingError: the estimator refuses one, or does not answer.
        """
        wanted = [Parameter(name, value=getattr(settings, name)) for name in LIVE_SETTINGS]
        request = SetParameters.Request(parameters=[p.to_parameter_msg() for p in wanted])
        response = self._answer("~/set_parameters", request)
        refused = [result.reason for result in response.results if not result.successful]
        if refused:
            raise RecordingError(f"{self._name('~/set_parameters')}: {'; '.join(refused)}")

    def wait_for(self, stamp: int) -> None:
        """Until the answers with a stamp are here, or are late."""
        _until(lambda: self.whole(stamp), _ANSWER_S)

    def whole(self, stamp: int) -> bool:
        """Whether the answers with a stamp are here."""
        return stamp in self.answers and len(self.answers[stamp]) == self._count

    def _answer(self, service: str, request: Any) -> Any:
        future = self._clients[service].call_async(request)
        if not _until(future.done, PATIENCE_S) or future.result() is None:
            raise RecordingError(f"{self._name(service)} does not answer")
        return future.result()

    def _name(self, topic: str) -> str:
        return resolved(topic, self._namespace)


def _until(condition: Callable[[], bool], patience_s: float) -> bool:
    end_s = time.monotonic() + patience_s
    while not condition():
        if time.monotonic() > end_s:
            return False
        time.sleep(_POLL_S)
    return True


class _Player:
    """Walks through the recording once.

    `_open` are samples that were sent and are not compared yet, with their numbers.
    """

    _first: Step

    def __init__(
        self, run: RecordedRun, rate: float, live: LiveEstimator, report: Callable[[str], object]
    ) -> None:
        self._run, self._rate, self._live, self._report = run, rate, live, report
        self._comparison = Comparison()
        self._others = deque(run.other_inputs)
        self._open: deque[tuple[int, Step]] = deque()
        self._start_s, self._start_ns = 0.0, 0

    def play(self) -> Comparison:
        """Publish and compare everything."""
        for sent, (states, sample) in enumerate(replayed_steps(self._run, self._comparison)):
            if not sent:
                self._begin(sample)
            self._pace(sample.log_ns)
            for state in states:
                self._repeat(state, begun=sent > 0)
            stamp = self._shifted(sample.stamp_ns)
            self._live.publish(topics.CABLE_TENSIONS, restamped(sample.sample, stamp))
            if sample.answered:
                self._open.append((self._comparison.samples, sample))
            if len(self._open) > MOST_OPEN:
                self._live.wait_for(self._shifted(self._open[0][1].stamp_ns))
            self._compare()
        self._await_answers()
        self._compare(to_the_end=True)
        if self._run.states:
            self._live.adjust(self._run.states[-1].settings)
        return self._comparison

    def _begin(self, first: Step) -> None:
        self._first = first
        states = self._run.states
        if states:
            self._adjust(states[0])
            if not any(event.kind is EventKind.START for event in states[0].events):
                self._report(
                    "the recording begins after its estimator, so the tare before is not in it; "
                    "the estimator that runs takes its own"
                )
                self._live.command(self._run.joint_names, states[0].command_rad)
        else:
            self._report(
                "no ~/journal in the recording: commands go as they came, tares not at all"
            )
        age_ns = min(max(first.log_ns - first.stamp_ns, 0), LONGEST_AGE_NS)
        self._start_s, self._start_ns = time.monotonic(), time.time_ns() - age_ns

    def _adjust(self, state: EstimatorState) -> None:
        update = {"stale_after_s": STALE_AFTER_S}
        self._live.adjust(state.settings.model_copy(update=update))

    def _pace(self, log_ns: int) -> None:
        """Wait for a sample's turn; what else came before it goes out before it."""
        while self._others and self._others[0].log_ns <= log_ns:
            other = self._others.popleft()
            self._sleep_until(other.log_ns)
            self._live.publish(other.topic, other.data)
        self._sleep_until(log_ns)

    def _sleep_until(self, log_ns: int) -> None:
        due_s = self._start_s + (log_ns - self._first.log_ns) * 1e-9 / self._rate
        time.sleep(max(0.0, due_s - time.monotonic()))

    def _shifted(self, stamp_ns: int) -> int:
        """A recorded stamp as it is sent, ns."""
        since_ns = stamp_ns - self._first.stamp_ns
        return self._start_ns + (since_ns if self._rate == 1.0 else round(since_ns / self._rate))

    def _repeat(self, state: EstimatorState, begun: bool) -> None:
        """Between the sample before and the next one, as when recorded."""
        if any(event.kind in _REPEATED for event in state.events):
            self._await_answers()
        for event in state.events:
            if event.kind in _COMMANDS:
                command_rad = event.command_rad or state.command_rad
                self._live.command(self._run.joint_names, command_rad)
            elif event.kind is EventKind.BREATH and state.breath.mark_ns:
                frame, stamp = breath_frame(state.breath.mark_turn), state.breath.mark_ns
                command = self._run.joint_names, state.command_rad
                self._live.command(*command, frame, self._shifted(stamp))
            elif event.kind in _SERVICES:
                self._live.call(_SERVICES[event.kind])
            elif event.kind is EventKind.SETTINGS:
                self._adjust(state)
            elif event.kind is EventKind.START and begun:
                self._report(
                    "the recorded estimator was started anew here; the one that runs is not"
                )
            elif event.kind in _NOT_REPEATED:
                self._report(
                    f"recorded here: {event.kind.value}; the estimator that runs does not see it"
                )

    def _await_answers(self) -> None:
        if self._open:
            self._live.wait_for(self._shifted(self._open[-1][1].stamp_ns))

    def _compare(self, to_the_end: bool = False) -> None:
        answers = self._live.answers
        while self._open:
            number, sample = self._open[0]
            stamp = self._shifted(sample.stamp_ns)
            # with more than MOST_OPEN the first was waited for in vain
            if not (self._live.whole(stamp) or to_the_end or len(self._open) > MOST_OPEN):
                break
            self._open.popleft()
            answered = answers.pop(stamp, {})
            replayed = {of: restamped(raw, sample.stamp_ns) for of, raw in answered.items()}
            self._comparison.compare(number, sample.answers, replayed)
