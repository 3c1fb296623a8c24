"""A recording of a live arm: samples with their answers, and the estimator's states between."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from pathlib import Path
from struct import Struct
from typing import Final, NamedTuple

from cablesense_gap.recordings.mcap_messages import BagTypes, McapMessages, RawMessage
from cablesense_gap.recordings.recording import RecordingError
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import CONTRACT, of_contract, segment_of
from cablesense_msgs_py.serialized import require_bounded, stamp_ns
from cablesense_msgs_py.topics import ContractError
from cablesense_online.state import EstimatorState, EventKind, state_of

MOST_STATES = 1_000_000
"""A hundred commands a second for hours; more would fill the memory."""
_MOST_STATE_BYTES = 1 << 30
_MOST_OPEN = 100_000
"""Samples that await their answer, whatever the times in the file: far more than any window."""
_WINDOW_NS = 2_000_000_000
"""An answer that has not come by then never came; no answer takes nearly as long."""
_STATE_AFTER_NS = 1_000_000_000
"""A state is published with the answer to its sample, so it is not recorded much later."""
WRENCH_NUMBERS: Final = Struct("<6d")
"""Force and torque, at the end of a serialized `WrenchStamped`."""


class RecordedSample(NamedTuple):
    """One sample, its answers, and the states that take effect with it.

    Attributes:
        stamp_ns: stamp of sample and answers.
        log_ns: time of recording.
        sample: serialized `JointState`.
        answers: serialized `WrenchStamped`: that of `~/wrench` at 0, those of segments at their
            numbers; none if the estimator was not running, did not receive the sample, or refused
            its stamp.
        states: states in their order.
        taken: whether the estimator took the sample. Its answer or its status was recorded, or it
            came after the estimator's start and before the first recorded answer: the recorder
            receives answers only once it has discovered the estimator.
    """

    stamp_ns: int
    log_ns: int
    sample: bytes
    answers: Mapping[int, bytes]
    states: tuple[EstimatorState, ...] = ()
    taken: bool = False

    @property
    def answered(self) -> bool:
        """Whether there is a wrench."""
        return 0 in self.answers


class RecordedRun:
    """A recording of `cablesense record`, with its journal read.

    Attributes:
        path: the file.
        states: the journal, in the order of recording.
        has_answers: whether it contains an estimator's answers.
        segments: numbers of the segments with wrenches, from a model of several contacts.
        cut: where the file breaks off, as text; empty if it is whole.
        unstamped: samples without a stamp, or that are no messages: no answer can be assigned.
            This and the next two were counted by the last `samples`.
        lone_contacts: answers with a contact whose sample is not in the recording.
        lone_zeros: zero wrenches with no sample's stamp: published in a silence, or at a sample
            whose stamp was refused.
    """

    def __init__(self, path: str | Path) -> None:
        """Read the file once.

        Raises:
            RecordingError: no recording, damaged, of two arms, or without tensions.
        """
        self.path = Path(path)
        self.unstamped = self.lone_contacts = self.lone_zeros = 0
        if self.path.is_dir():
            raise RecordingError(f"{path}: is a folder; give the .mcap file in it")
        messages, types = McapMessages(self.path), BagTypes()
        self._logged_ns: list[int] = []
        states: list[EstimatorState] = []
        names: dict[str, str] = {}
        segments: set[int] = set()
        kept_bytes = 0
        for raw in messages:
            topic = of_contract(raw.topic)
            if topic is None:
                continue
            if number := segment_of(raw.topic):
                segments.add(number)
                continue
            self._check(topic, raw, names)
            if topic != topics.JOURNAL:
                continue
            states.append(self._state(types, raw, len(states) + 1))
            self._logged_ns.append(raw.log_ns)
            kept_bytes += len(raw.data)
            if len(states) > MOST_STATES or kept_bytes > _MOST_STATE_BYTES:
                raise RecordingError(
                    f"{path}: more than {MOST_STATES} states, or more than "
                    f"{_MOST_STATE_BYTES >> 20} MiB of them; record shorter runs"
                )
        if topics.CABLE_TENSIONS not in names:
            there = ", ".join(sorted(names.values())[:8]) or "nothing"
            raise RecordingError(
                f"{path}: has no {topics.CABLE_TENSIONS}, but {there}; record with: cablesense "
                "record"
            )
        self.states = tuple(states)
        self.has_answers = topics.WRENCH in names
        self.segments = tuple(sorted(segments))
        self.cut = messages.cut

    def samples(self) -> Iterator[RecordedSample]:
        """Every sample that has a stamp, in order.

        Raises:
            RecordingError: the file has become unreadable.
        """
        following, before_first_answer = 0, False
        for sample in self._answered_samples():
            first = following
            while following < len(self.states):
                state, log_ns = self.states[following], self._logged_ns[following]
                # after a step back of the clock, stamps alone do not order states and samples
                if state.before_ns > sample.stamp_ns or log_ns > sample.log_ns + _STATE_AFTER_NS:
                    break
                following += 1
            states = self.states[first:following]
            before_first_answer |= any(
                event.kind is EventKind.START for state in states for event in state.events
            )
            before_first_answer &= not sample.answered
            taken = sample.taken or before_first_answer or sample.answered
            yield sample._replace(states=states, taken=taken)

    def _answered_samples(self) -> Iterator[RecordedSample]:
        """Samples and answers paired by their stamps, in the order of the samples."""
        self.unstamped = self.lone_contacts = self.lone_zeros = 0
        samples: deque[RecordedSample] = deque()
        answers: dict[int, tuple[int, dict[int, bytes]]] = {}
        stated: dict[int, None] = {}
        for message in McapMessages(self.path):
            topic = of_contract(message.topic)
            if topic == topics.CABLE_TENSIONS:
                stamp = _stamp(message.data)
                if stamp:
                    samples.append(RecordedSample(stamp, message.log_ns, message.data, {}))
                else:
                    self.unstamped += 1
            elif topic in (topics.WRENCH, topics.SEGMENT_WRENCHES):
                beginning: tuple[int, dict[int, bytes]] = (message.log_ns, {})
                _, given = answers.setdefault(_stamp(message.data), beginning)
                given[segment_of(message.topic)] = message.data
            elif topic == topics.STATUS:
                stated[_stamp(message.data)] = None
                if len(stated) > _MOST_OPEN:
                    del stated[next(iter(stated))]
                continue
            else:
                continue
            for sample in self._settled(samples, answers, message.log_ns - _WINDOW_NS):
                yield sample._replace(taken=sample.stamp_ns in stated)
        for sample in self._settled(samples, answers, 2**63):
            yield sample._replace(taken=sample.stamp_ns in stated)

    def _settled(
        self,
        samples: deque[RecordedSample],
        answers: dict[int, tuple[int, dict[int, bytes]]],
        before_ns: int,
    ) -> Iterator[RecordedSample]:
        """Remove samples whose answers are complete, or that were recorded before a time."""
        while samples and (
            len(answers.get(samples[0].stamp_ns, (0, {}))[1]) > len(self.segments)
            or samples[0].log_ns < before_ns
            or len(samples) > _MOST_OPEN
        ):
            sample = samples.popleft()
            _, given = answers.pop(sample.stamp_ns, (0, {}))
            yield sample._replace(answers=given)
        while answers:
            stamp, (log_ns, given) = next(iter(answers.items()))
            if log_ns >= before_ns - _WINDOW_NS and len(answers) <= _MOST_OPEN:
                break
            del answers[stamp]
            if 0 in given:
                contact = shows_contact(given[0])
                self.lone_contacts += contact
                self.lone_zeros += not contact

    def _check(self, topic: str, raw: RawMessage, names: dict[str, str]) -> None:
        first = names.setdefault(topic, raw.topic)
        if raw.topic != first and not topic.startswith("/"):
            raise RecordingError(
                f"{self.path}: {first} and {raw.topic} are both {topic}; record one arm alone"
            )
        if raw.kind != CONTRACT[topic].kind:
            raise RecordingError(
                f"{self.path}: {raw.topic} is of type {raw.kind[:80]!r}; it must be "
                f"{CONTRACT[topic].kind}"
            )

    def _state(self, types: BagTypes, raw: RawMessage, number: int) -> EstimatorState:
        where = f"{self.path}: {raw.topic}, message {number}"
        try:
            return state_of(types.message(raw.kind, raw.data))
        except ContractError as error:
            raise RecordingError(f"{where}: {error}") from error
        except Exception as error:  # bytes that are no message raise anything in a parser
            raise RecordingError(f"{where}: cannot be read ({error})") from error


def shows_contact(answer: bytes) -> bool:
    """Whether a serialized `WrenchStamped` is a force: anything but zero or not a number."""
    if len(answer) < WRENCH_NUMBERS.size:
        return True
    return any(abs(part) > 0.0 for part in WRENCH_NUMBERS.unpack(answer[-WRENCH_NUMBERS.size :]))


def _stamp(raw: bytes) -> int:
    try:
        require_bounded(raw)
        return stamp_ns(raw)
    except ContractError:
        return 0
