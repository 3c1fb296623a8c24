"""A recording of a live arm, answered again by the same `Estimation` and compared.

`RecordedRun` pairs samples with their answers and the estimator's states between them.
`replay_in_process` rebuilds the estimator of each recorded state and runs as fast as it can.
"""

from __future__ import annotations

import csv
import math
import struct
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from cablesense_base.files import written_whole
from cablesense_gap.recordings.mcap_messages import McapMessages, RawMessage, parsed_message
from cablesense_gap.recordings.recording import RecordingError
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import CONTRACT, of_contract, segment_of
from cablesense_msgs_py.serialized import WrenchWriter, require_bounded, stamp_ns, wrench_writers
from cablesense_msgs_py.topics import ContractError, Frames
from cablesense_online.answer import Answer
from cablesense_online.estimation import Estimation
from cablesense_online.models import LoadedModel, load_model
from cablesense_online.state import LIVE_SETTINGS, EstimatorState, EventKind, state_of
from cablesense_training.inference.metadata import find_model

_WINDOW_NS = 2_000_000_000
"""An answer that has not come by then never came; no answer takes nearly as long."""
_STATE_AFTER_NS = 1_000_000_000
"""A state is published with the answer to its sample, so it is not recorded much later."""
_WRENCH_NUMBERS: Final = struct.Struct("<6d")
"""Force and torque."""
_STATUS = -1
"""The status of an answer has this number among those of its wrenches."""


class RecordedSample(NamedTuple):
    """One sample, its answers, and the states that take effect with it.

    Attributes:
        stamp_ns: stamp of sample and answers.
        log_ns: time of recording.
        sample: serialized `JointState`.
        answers: serialized `WrenchStamped`: that of `~/wrench` at 0, those of segments at their
            numbers; none if the estimator was not running, did not receive the sample, or refused
            its stamp.
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
        states: the journal, in the order of recording.
        has_answers: whether it contains an estimator's answers.
        segments: numbers of the segments with wrenches, from a model of several contacts.
        cut: where the file breaks off, as text; empty if it is whole.
        lone_contacts: number of answers with a contact, by the last `samples`, whose sample is not
            in the recording.
    """

    def __init__(self, path: str | Path) -> None:
        """Read the file once.

        Raises:
            RecordingError: no recording, damaged, of two arms, or without tensions.
        """
        self.path = Path(path)
        self.lone_contacts = 0
        if self.path.is_dir():
            raise RecordingError(f"{path}: is a folder; give the .mcap file in it")
        messages = McapMessages(self.path)
        self._journal: list[tuple[int, EstimatorState]] = []
        names: dict[str, str] = {}
        segments: set[int] = set()
        for raw in messages:
            topic = of_contract(raw.topic)
            if number := segment_of(raw.topic):
                segments.add(number)
            elif topic is not None:
                self._check(topic, raw, names)
                if topic == topics.JOURNAL:
                    self._journal.append((raw.log_ns, self._state(raw)))
        if topics.CABLE_TENSIONS not in names:
            there = ", ".join(sorted(names.values())[:8]) or "nothing"
            raise RecordingError(
                f"{path}: has no {topics.CABLE_TENSIONS}, but {there}; record with: cablesense "
                "record"
            )
        self.states = tuple(state for _, state in self._journal)
        self.has_answers = topics.WRENCH in names
        self.segments = tuple(sorted(segments))
        self.cut = messages.cut

    def samples(self) -> Iterator[RecordedSample]:
        """Every sample in order; no answer can be assigned to one without a stamp.

        Raises:
            RecordingError: the file has become unreadable.
        """
        journal, before_first_answer = deque(self._journal), False
        for sample in self._answered_samples():
            states: list[EstimatorState] = []
            # after a step back of the clock, stamps alone do not order states and samples
            while (
                journal
                and journal[0][1].before_ns <= sample.stamp_ns
                and journal[0][0] <= sample.log_ns + _STATE_AFTER_NS
            ):
                states.append(journal.popleft()[1])
            before_first_answer |= any(
                event.kind is EventKind.START for state in states for event in state.events
            )
            before_first_answer &= not sample.answered
            taken = sample.taken or before_first_answer or sample.answered
            yield sample._replace(states=tuple(states), taken=taken)

    def _answered_samples(self) -> Iterator[RecordedSample]:
        """Samples and answers paired by their stamps, in the order of the samples."""
        self.lone_contacts = 0
        samples: deque[RecordedSample] = deque()
        answers: dict[int, tuple[int, dict[int, bytes]]] = {}  # by stamp, since when
        for message in McapMessages(self.path):
            topic = of_contract(message.topic)
            stamp = _stamp(message.data)
            if topic == topics.CABLE_TENSIONS:
                samples.append(RecordedSample(stamp, message.log_ns, message.data, {}))
            elif topic in (topics.WRENCH, topics.SEGMENT_WRENCHES, topics.STATUS) and stamp:
                number = _STATUS if topic == topics.STATUS else segment_of(message.topic)
                _, given = answers.setdefault(stamp, (message.log_ns, {}))
                given[number] = message.data
            yield from self._settled(samples, answers, message.log_ns - _WINDOW_NS)
        yield from self._settled(samples, answers, 2**63)

    def _settled(
        self,
        samples: deque[RecordedSample],
        answers: dict[int, tuple[int, dict[int, bytes]]],
        before_ns: int,
    ) -> Iterator[RecordedSample]:
        """Remove samples whose answers are complete, or that were recorded before a time."""
        wanted = {0, *self.segments}
        while samples and (
            samples[0].log_ns < before_ns
            or wanted <= answers.get(samples[0].stamp_ns, (0, {}))[1].keys()
        ):
            sample = samples.popleft()
            _, given = answers.pop(sample.stamp_ns, (0, {}))
            taken = given.pop(_STATUS, None) is not None
            yield sample._replace(answers=given, taken=taken)
        while answers and next(iter(answers.values()))[0] < before_ns - _WINDOW_NS:
            _, given = answers.pop(next(iter(answers)))
            self.lone_contacts += any(_numbers(given.get(0, b"")))

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

    def _state(self, raw: RawMessage) -> EstimatorState:
        where = f"{self.path}: {raw.topic}, message {len(self._journal) + 1}"
        try:
            return state_of(parsed_message(raw))
        except ContractError as error:
            raise RecordingError(f"{where}: {error}") from error
        except Exception as error:  # bytes that are no message raise anything in a parser
            raise RecordingError(f"{where}: cannot be read ({error})") from error


def _stamp(raw: bytes) -> int:
    try:
        require_bounded(raw)
        return stamp_ns(raw)
    except ContractError:
        return 0


_COUNTED: Final = {
    "samples": "samples recorded",
    "unanswered": "not answered when recorded (no estimator, no stamp, or a refused one)",
    "before_journal": "answered before the journal has a usable state, so not compared",
    "lone_contacts": "contacts whose sample is not in the recording",
    "compared": "compared",
    "contacts": "of these contacts",
    "identical": "bit-identical",
}


@dataclass
class Comparison:
    """Counts, which `lines` words, and the first difference as text, if any."""

    samples: int = 0
    compared: int = 0
    identical: int = 0
    contacts: int = 0
    unanswered: int = 0
    before_journal: int = 0
    lone_contacts: int = 0
    first_difference: str = ""

    def compare(self, recorded: Mapping[int, bytes], replayed: Mapping[int, bytes]) -> None:
        """Compare the answers to the last sample; all that was recorded must be replayed."""
        self.compared += 1
        self.contacts += any(_numbers(recorded[0]))
        other = [number for number, raw in recorded.items() if replayed.get(number) != raw]
        self.identical += not other
        if other and not self.first_difference:
            raw, again = recorded[other[0]], replayed.get(other[0], b"")
            self.first_difference = (
                f"sample {self.samples}, stamp {stamp_ns(raw)}: {_numbers(raw)} recorded, "
                f"{_numbers(again)} replayed"
            )

    @property
    def same(self) -> bool:
        """Whether there was something to compare, and no difference."""
        return 0 < self.compared == self.identical

    @property
    def lines(self) -> list[str]:
        """One line for each count, and the first difference."""
        lines = [f"{getattr(self, name):>10,}  {means}" for name, means in _COUNTED.items()]
        if self.first_difference:
            lines.append(f"first difference: {self.first_difference}")
        return lines


def _numbers(raw: bytes) -> tuple[float, ...]:
    """Force and torque of a serialized `WrenchStamped`, zero where unknown; else none."""
    size = _WRENCH_NUMBERS.size
    numbers = _WRENCH_NUMBERS.unpack(raw[-size:]) if len(raw) >= size else ()
    return tuple(0.0 if math.isnan(number) else number for number in numbers)


class RebuiltEstimation:
    """An estimation that goes from state to state and answers samples as serialized wrenches.

    Its arm and model are `loaded` with the first state.
    """

    def __init__(self, arm: str, model: str) -> None:
        """With the recorded model, or with another `arm` or `model` if one is given."""
        self._arm, self._model = arm, model
        self.loaded: LoadedModel | None = None
        self._built_for: object = None
        self._estimation: Estimation | None = None
        self._writers: list[WrenchWriter] = []
        self._unknown_force = "zero"

    @property
    def reproducible(self) -> bool:
        """Whether the answers must be those of the recording."""
        return self._estimation is not None and self._estimation.reproducible

    def restore(self, state: EstimatorState) -> None:
        """Continue from a state.

        Raises:
            CableSenseError: the model is missing or has changed since, or the state is one of
                another arm.
        """
        fixed = state.settings.model_dump(exclude=set(LIVE_SETTINGS))
        wanted = (state.arm, state.origin, fixed)
        if self._estimation is None or wanted != self._built_for:
            self.loaded = loaded = self._load(state.origin)
            prefix = state.origin.get("frame_prefix", "")
            self._writers = wrench_writers(Frames(loaded.arm.segment_count, prefix))
            self._estimation = Estimation(loaded.arm, loaded.estimator, state.settings, 0.0)
            self._unknown_force = state.settings.unknown_force
            self._built_for = wanted
        self._estimation.adjust(**{name: getattr(state.settings, name) for name in LIVE_SETTINGS})
        self._estimation.restore(state)

    def answer(self, sample: RecordedSample) -> tuple[Answer, dict[int, bytes]]:
        """The answer to a sample, and its wrenches, numbered as in `RecordedSample.answers`."""
        assert self._estimation is not None
        stamp = sample.stamp_ns
        answer = self._estimation.sample(sample.sample, stamp, stamp * 1e-9)
        numbered = {0: (answer.contact.segment, answer.wrench(self._unknown_force))}
        for number in sample.answers.keys() - {0}:
            numbered[number] = number, answer.on_segment(number, self._unknown_force)
        return answer, {
            number: self._writers[segment].write(stamp, wrench)
            for number, (segment, wrench) in numbered.items()
            if wrench is not None
        }

    def _load(self, origin: Mapping[str, str]) -> LoadedModel:
        if self._arm:
            return load_model(self._arm, self._model)
        if self._model:
            return LoadedModel.open(find_model(self._model))
        path, digest = Path(origin.get("model", "")), origin.get("model SHA-256", "")
        loaded = LoadedModel.open(path if path.is_file() else find_model(path.stem))
        if loaded.origin["model SHA-256"] != digest:
            raise RecordingError(
                f"the recording is of a model {path.name} with SHA-256 {digest[:12]}…, and "
                f"{loaded.model} is another; name the model with --model"
            )
        return loaded


def replay_in_process(
    run: RecordedRun, arm: str = "", model: str = "", estimates: Path | None = None
) -> Comparison:
    """Answer every recorded sample that the live estimator answered, and compare.

    The answers rest on the journal and the samples alone. A recording that was played faster or
    started in mid-move gives the same answers. So does another machine with the same arithmetic
    and the same versions of the libraries.

    Args:
        run: the recording.
        arm: one other than the recorded one, or empty.
        model: as `arm`.
        estimates: a CSV file for the answers, numbers with all their digits. `segment` is 0
            without a contact. Probabilities are empty if nothing was estimated: in a move, before
            the first tare, and at a sample that was refused, whose `problem` is given.

    Raises:
        RecordingError: the recording lacks what a replay needs, or `estimates` cannot be written.
        CableSenseError: the model is not to be found, or does not fit.
    """
    if not run.states:
        raise RecordingError(
            f"{run.path}: has no ~/journal, and without it tare and command are unknown at each "
            "sample; record with: cablesense record"
        )
    comparison = Comparison()
    compared = _compared(run, RebuiltEstimation(arm, model), comparison)
    if estimates is None:
        deque(compared, maxlen=0)
        return comparison
    with (
        written_whole(estimates, RecordingError) as partial,
        partial.open("w", encoding="utf-8", newline="") as file,
    ):
        table = csv.writer(file, lineterminator="\n")
        for number, (stamp, answer, segment_count) in enumerate(compared):
            if number == 0:
                segments = [f"p_segment_{n + 1}" for n in range(segment_count)]
                head = ("stamp_ns", "segment", "angle_deg", "magnitude_n", "p_none")
                table.writerow([*head, *segments, "problem"])
            segment, *touched = answer.contact[:3]
            probabilities = answer.probabilities or ("",) * (segment_count + 1)
            problem = "" if answer.problem is None else answer.problem.kind.value
            row = (stamp, segment, *(touched if segment else ("", "")), *probabilities, problem)
            table.writerow(row)
    return comparison


def _compared(
    run: RecordedRun, rebuilt: RebuiltEstimation, comparison: Comparison
) -> Iterator[tuple[int, Answer, int]]:
    """Stamp, answer and number of segments of each sample that was compared."""
    for sample in run.samples():
        comparison.samples += 1
        comparison.unanswered += not sample.answered
        for state in sample.states:
            rebuilt.restore(state)
        if not sample.stamp_ns or (run.has_answers and not sample.taken):
            continue
        if rebuilt.loaded is None:
            comparison.before_journal += sample.answered
            continue
        answer, wrenches = rebuilt.answer(sample)
        if not sample.answered:
            continue  # a history-dependent model has received it
        if not rebuilt.reproducible:
            comparison.before_journal += 1
            continue
        comparison.compare(sample.answers, wrenches)
        yield sample.stamp_ns, answer, rebuilt.loaded.arm.segment_count
    comparison.lone_contacts = run.lone_contacts
