"""A recording of a whole system: its journal, and its samples with what changed before them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from cablesense_gap.recordings.bag_types import BagTypes
from cablesense_gap.recordings.mcap_messages import McapMessages, RawMessage
from cablesense_gap.recordings.recording_error import RecordingError
from cablesense_msgs_py import topics
from cablesense_msgs_py.contract_error import ContractError
from cablesense_msgs_py.journal import EventKind, JournalEntry, journal_entry
from cablesense_msgs_py.topic_types import CONTRACT, INPUTS, of_contract
from cablesense_ros.replay.answered_samples import AnsweredSample, AnsweredSamples

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
