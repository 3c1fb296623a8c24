"""A recording of a whole system: its journal, and its samples with what changed before them.

Recorded samples beside the answers that they got.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from struct import Struct
from typing import NamedTuple

from cablesense_gap.recordings.mcap_messages import BagTypes, McapMessages, RawMessage
from cablesense_gap.recordings.recording import RecordingError
from cablesense_msgs_py import topics
from cablesense_msgs_py.journal import EventKind, JournalEntry, journal_entry
from cablesense_msgs_py.serialized import stamp_ns
from cablesense_msgs_py.topic_types import CONTRACT, INPUTS, of_contract
from cablesense_msgs_py.topics import ContractError

_WRENCH = Struct("<6d")

WINDOW_NS = 2_000_000_000
"""An answer that has not come this long after its sample never came; far longer than any takes."""


class AnsweredSample(NamedTuple):
    """A sample, and the wrench with its stamp.

    Attributes:
        stamp_ns: of both.
        log_ns: when the sample was recorded.
        sample: serialized `JointState`.
        answer: serialized `WrenchStamped`; none where the estimator took no notice of the sample:
            it was not running, did not get it, or refused its stamp.
    """

    stamp_ns: int
    log_ns: int
    sample: bytes
    answer: bytes | None


class AnsweredSamples:
    """Pairs samples and answers by their stamps, in the order of the samples.

    Attributes:
        unstamped: samples without a stamp, or that are no messages: no answer can be told theirs.
        lone_contacts: answers with a contact whose sample the recording lacks.
        lone_zeros: zero wrenches with no sample's stamp: the estimator's word in a silence, or at
            a sample whose stamp it refused.
    """

    def __init__(self) -> None:
        self.unstamped = 0
        self.lone_contacts = 0
        self.lone_zeros = 0
        self._samples: deque[tuple[int, int, bytes]] = deque()
        self._answers: dict[int, tuple[int, bytes]] = {}

    def of(self, messages: Iterable[RawMessage]) -> Iterator[AnsweredSample]:
        """The samples among messages of one arm, in the order they were recorded."""
        for message in messages:
            topic = of_contract(message.topic)
            if topic == topics.CABLE_TENSIONS:
                stamp = _stamp(message.data)
                if stamp:
                    self._samples.append((stamp, message.log_ns, message.data))
                else:
                    self.unstamped += 1
            elif topic == topics.WRENCH:
                self._answers[_stamp(message.data)] = (message.log_ns, message.data)
            else:
                continue
            yield from self._settled(message.log_ns - WINDOW_NS)
        yield from self._settled(2**63)

    def _settled(self, before_ns: int) -> Iterator[AnsweredSample]:
        while self._samples:
            stamp, log_ns, sample = self._samples[0]
            if stamp not in self._answers and log_ns >= before_ns:
                break
            self._samples.popleft()
            _, answer = self._answers.pop(stamp, (0, None))
            yield AnsweredSample(stamp, log_ns, sample, answer)
        while self._answers:
            stamp, (log_ns, answer) = next(iter(self._answers.items()))
            if log_ns >= before_ns - WINDOW_NS:
                break
            del self._answers[stamp]
            if shows_contact(answer):
                self.lone_contacts += 1
            else:
                self.lone_zeros += 1


def shows_contact(answer: bytes) -> bool:
    """Whether a serialized `WrenchStamped` is anything but zero."""
    return len(answer) < _WRENCH.size or any(_WRENCH.unpack(answer[-_WRENCH.size :]))


def _stamp(raw: bytes) -> int:
    try:
        return stamp_ns(raw)
    except ContractError:
        return 0


MOST_CHANGES = 1_000_000
"""A hundred commands a second for hours; more would fill the memory."""

_ENTRY_AFTER_NS = 1_000_000_000
"""An entry is published with the answer to its sample, so it is not recorded much later."""


class Step(NamedTuple):
    """One sample, and the journal entries that take effect with it.

    Attributes:
        taken: whether the estimator took the sample: its answer was recorded, or the sample came
            after the estimator's start and before the first answer that the recorder heard. The
            recorder hears answers only once it has found the estimator; the entry of the start
            waits for it.
    """

    entries: tuple[JournalEntry, ...]
    pair: AnsweredSample
    taken: bool


class RecordedRun:
    """Opens a recording of `cablesense record` and reads its journal.

    Attributes:
        path: of the file.
        entries: the journal.
        other_inputs: loads and trials, and commands where no journal tells their place; the topic
            is the contract's.
        cut: where the file breaks off, in words; empty if it is whole.
        pairs: what the last `steps` found beside the samples.
    """

    def __init__(self, path: str | Path) -> None:
        """Go through the file once.

        Raises:
            RecordingError: no recording, damaged, of two arms, or without tensions.
        """
        self.path = Path(path)
        self.pairs = AnsweredSamples()
        if self.path.is_dir():
            raise RecordingError(f"{path}: is a folder; give the .mcap file in it")
        messages, types = McapMessages(self.path), BagTypes()
        entries: list[tuple[int, JournalEntry]] = []
        names: dict[str, str] = {}
        others: list[RawMessage] = []
        for raw in messages:
            topic = of_contract(raw.topic)
            if topic is None:
                continue
            self._check(topic, raw, names)
            if topic == topics.JOURNAL:
                entries.append((raw.log_ns, self._entry(types, raw, len(entries) + 1)))
            elif topic in INPUTS and topic != topics.CABLE_TENSIONS:
                others.append(raw._replace(topic=topic))
            if len(entries) + len(others) > MOST_CHANGES:
                raise RecordingError(f"{path}: more than {MOST_CHANGES} commands and loads")
        if topics.CABLE_TENSIONS not in names:
            there = ", ".join(sorted(names.values())[:8]) or "nothing"
            raise RecordingError(
                f"{path}: has no {topics.CABLE_TENSIONS}, but {there}; record with: cablesense "
                "record"
            )
        self._entries = entries
        self.other_inputs = [
            raw for raw in others if not (entries and raw.topic == topics.JOINT_COMMANDS)
        ]
        self._names = names
        self.cut = messages.cut

    @property
    def entries(self) -> tuple[JournalEntry, ...]:
        """The journal, in the order it was recorded."""
        return tuple(entry for _, entry in self._entries)

    @property
    def joint_names(self) -> list[str]:
        """As the journal says."""
        return self._entries[0][1].settings.get("joints", "").split() if self._entries else []

    @property
    def has_answers(self) -> bool:
        """Whether an estimator's answers are in it."""
        return topics.WRENCH in self._names

    def steps(self) -> Iterator[Step]:
        """Every sample that has a stamp, in order.

        Raises:
            RecordingError: the file has become unreadable.
        """
        self.pairs = AnsweredSamples()
        following, unheard = 0, False
        for pair in self.pairs.of(McapMessages(self.path)):
            first = following
            while following < len(self._entries):
                log_ns, entry = self._entries[following]
                # after a step back of the clock, stamps alone do not say which came first
                if entry.before_ns > pair.stamp_ns or log_ns > pair.log_ns + _ENTRY_AFTER_NS:
                    break
                following += 1
            entries = tuple(entry for _, entry in self._entries[first:following])
            unheard |= any(event.kind is EventKind.START for e in entries for event in e.events)
            unheard &= pair.answer is None
            yield Step(entries, pair, unheard or pair.answer is not None)

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

    def _entry(self, types: BagTypes, raw: RawMessage, number: int) -> JournalEntry:
        try:
            return journal_entry(types.message(raw.kind, raw.data))
        except ContractError as error:
            raise RecordingError(f"{self.path}: {raw.topic}, message {number}: {error}") from error
        except Exception as error:  # bytes that are no message raise anything in a parser
            raise RecordingError(
                f"{self.path}: {raw.topic}, message {number}: cannot be read ({error})"
            ) from error
