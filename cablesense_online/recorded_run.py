"""A recording of a live arm: samples with their answers, and the estimator's states between."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from pathlib import Path
from struct import Struct
from typing import NamedTuple

from cablesense_gap.recordings.mcap_messages import BagTypes, McapMessages, RawMessage
from cablesense_gap.recordings.recording import RecordingError
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import CONTRACT, INPUTS, of_contract, segment_of
from cablesense_msgs_py.serialized import require_bounded, stamp_ns
from cablesense_msgs_py.topics import ContractError
from cablesense_online.state import EstimatorState, EventKind, state_of

MOST_CHANGES = 1_000_000
"""A hundred commands a second for hours; more would fill the memory."""
_MOST_KEPT_BYTES = 1 << 30
"""Of the messages that these are in."""
_MOST_OPEN = 100_000
"""Samples that wait for their answer, whatever the times in the file: far more than any window."""
_WINDOW_NS = 2_000_000_000
"""An answer that has not come this long after its sample never came; far longer than any takes."""
_STATE_AFTER_NS = 1_000_000_000
"""A state is published with the answer to its sample, so it is not recorded much later."""
_WRENCH = Struct("<6d")
_IN_JOURNAL = (topics.JOINT_COMMANDS, topics.CABLE_OFFSETS)


class Step(NamedTuple):
    """One sample, its answers, and the states that take effect with it.

    Attributes:
        stamp_ns: of sample and answer.
        log_ns: when the sample was recorded.
        sample: serialized `JointState`.
        answers: serialized `WrenchStamped`, that of `~/wrench` at 0 and those of segments at their
            numbers; none where the estimator was not running, did not receive the sample, or
            refused its stamp.
        states: in their order.
        taken: whether the estimator took the sample: its answer was recorded, or its state, where
            no wrench of an unknown force is published, or the sample came after the estimator's
            start and before the first recorded answer. The recorder receives answers only once it
            has discovered the estimator; the state of the start waits for it.
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
        path: of the file.
        states: the journal, in the order it was recorded.
        other_inputs: loads and trials, and commands and offsets where no journal has their place;
            the topic is the contract's.
        has_answers: whether an estimator's answers are in it.
        segments: numbers of those that have wrenches of their own, from a model of several
            contacts.
        cut: where the file breaks off, as text; empty if it is whole.
        unstamped: samples without a stamp, or that are no messages: no answer can be assigned.
            This and the two below were counted by the last `steps`.
        lone_contacts: answers with a contact whose sample is not in the recording.
        lone_zeros: zero wrenches with no sample's stamp: published in a silence, or at a sample
            whose stamp was refused.
    """

    def __init__(self, path: str | Path) -> None:
        """Go through the file once.

        Raises:
            RecordingError: no recording, damaged, of two arms, or without tensions.
        """
        self.path = Path(path)
        self.unstamped = self.lone_contacts = self.lone_zeros = 0
        if self.path.is_dir():
            raise RecordingError(f"{path}: is a folder; give the .mcap file in it")
        messages, types = McapMessages(self.path), BagTypes()
        self._logged: list[tuple[int, EstimatorState]] = []
        names: dict[str, str] = {}
        segments: set[int] = set()
        others: list[RawMessage] = []
        kept_bytes = 0
        for raw in messages:
            topic = of_contract(raw.topic)
            if topic is None:
                continue
            if number := segment_of(raw.topic):
                segments.add(number)
                continue
            self._check(topic, raw, names)
            if topic == topics.JOURNAL:
                self._logged.append((raw.log_ns, self._state(types, raw)))
            elif topic in INPUTS and topic != topics.CABLE_TENSIONS:
                others.append(raw._replace(topic=topic))
            else:
                continue
            kept_bytes += len(raw.data)
            if len(self._logged) + len(others) > MOST_CHANGES or kept_bytes > _MOST_KEPT_BYTES:
                raise RecordingError(
                    f"{path}: more than {MOST_CHANGES} commands and loads, or more than "
                    f"{_MOST_KEPT_BYTES >> 20} MiB of them; record shorter runs"
                )
        if topics.CABLE_TENSIONS not in names:
            there = ", ".join(sorted(names.values())[:8]) or "nothing"
            raise RecordingError(
                f"{path}: has no {topics.CABLE_TENSIONS}, but {there}; record with: cablesense "
                "record"
            )
        self.states = tuple(state for _, state in self._logged)
        self.other_inputs = [
            raw for raw in others if not (self.states and raw.topic in _IN_JOURNAL)
        ]
        self.has_answers = topics.WRENCH in names
        self.segments = tuple(sorted(segments))
        self.cut = messages.cut

    @property
    def joint_names(self) -> list[str]:
        """As the journal has them."""
        return self.states[0].origin.get("joints", "").split() if self.states else []

    def steps(self) -> Iterator[Step]:
        """Every sample that has a stamp, in order.

        Raises:
            RecordingError: the file has become unreadable.
        """
        following, before_first_answer = 0, False
        for step in self._answered_samples():
            first = following
            while following < len(self._logged):
                log_ns, state = self._logged[following]
                # after a step back of the clock, stamps alone do not order states and samples
                if state.before_ns > step.stamp_ns or log_ns > step.log_ns + _STATE_AFTER_NS:
                    break
                following += 1
            states = self.states[first:following]
            before_first_answer |= any(
                event.kind is EventKind.START for state in states for event in state.events
            )
            before_first_answer &= not step.answered
            yield step._replace(
                states=states,
                taken=step.taken or before_first_answer or step.answered,
            )

    def _answered_samples(self) -> Iterator[Step]:
        """Samples and answers paired by their stamps, in the order of the samples."""
        self.unstamped = self.lone_contacts = self.lone_zeros = 0
        samples: deque[Step] = deque()
        answers: dict[int, tuple[int, dict[int, bytes]]] = {}
        stated: dict[int, None] = {}
        for message in McapMessages(self.path):
            topic = of_contract(message.topic)
            if topic == topics.CABLE_TENSIONS:
                stamp = _stamp(message.data)
                if stamp:
                    samples.append(Step(stamp, message.log_ns, message.data, {}))
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
            for step in self._settled(samples, answers, message.log_ns - _WINDOW_NS):
                yield step._replace(taken=step.stamp_ns in stated)
        for step in self._settled(samples, answers, 2**63):
            yield step._replace(taken=step.stamp_ns in stated)

    def _settled(
        self,
        samples: deque[Step],
        answers: dict[int, tuple[int, dict[int, bytes]]],
        before_ns: int,
    ) -> Iterator[Step]:
        """Take out the samples whose answers are there, or that were recorded before a time."""
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

    def _state(self, types: BagTypes, raw: RawMessage) -> EstimatorState:
        where = f"{self.path}: {raw.topic}, message {len(self._logged) + 1}"
        try:
            return state_of(types.message(raw.kind, raw.data))
        except ContractError as error:
            raise RecordingError(f"{where}: {error}") from error
        except Exception as error:  # bytes that are no message raise anything in a parser
            raise RecordingError(f"{where}: cannot be read ({error})") from error


def shows_contact(answer: bytes) -> bool:
    """Whether a serialized `WrenchStamped` is a force: anything but zero or not a number."""
    if len(answer) < _WRENCH.size:
        return True
    return any(abs(part) > 0.0 for part in _WRENCH.unpack(answer[-_WRENCH.size :]))


def _stamp(raw: bytes) -> int:
    try:
        require_bounded(raw)
        return stamp_ns(raw)
    except ContractError:
        return 0
