"""A recording of a live arm, answered again by the same `Estimation` and compared.

Answers rest on messages alone: tensions, commands, and the calibrations that the estimator
published when they changed. `RecordedRun` reads them in the order of recording, `replay` answers
them again, as fast as it can.
"""

from __future__ import annotations

import csv
import math
import struct
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from cablesense_base import CableSenseError
from cablesense_base.files import written_whole
from cablesense_contact.calibration_file import calibration_of
from cablesense_contact.inference.metadata import find_model
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import RECORDED_TOPICS, recorded_topic
from cablesense_msgs_py.serialized import WrenchWriter, require_bounded, stamp_ns, wrench_writers
from cablesense_msgs_py.topics import ContractError
from cablesense_online.answer import Answer
from cablesense_online.answer_table import ANSWER_COLUMNS, answer_cells
from cablesense_online.estimation import Estimation
from cablesense_online.inputs import REPLAYED_FROM
from cablesense_online.loading import load
from cablesense_online.models import Loaded, LoadedModel
from cablesense_online.placed_links import PlacedLinks, contact_frames
from cablesense_online.provenance import Beginning, Provenance
from cablesense_online.settings import LIVE_SETTINGS
from cablesense_recording.mcap_messages import McapMessages, RawMessage, parsed_message
from cablesense_recording.recording import RecordingError
from cablesense_sim.machine.description import is_machine_file

_WRENCH_NUMBERS: Final = struct.Struct("<6d")
"""Force and torque."""


@dataclass(frozen=True)
class CalibrationMessage:
    """A calibration as the estimator published it.

    Attributes:
        topic: as recorded.
        provenance, beginning: what it ran with it, and from when on.
        content: the calibration, as the content of a file.
    """

    topic: str
    provenance: Provenance
    beginning: Beginning
    content: bytes


class RecordedRun:
    """A recording of `cablesense record`.

    Attributes:
        path: of the file.
        answers: the recorded wrenches, serialized, by the stamps of their samples.
        cut: where the file breaks off, as text; empty if it is whole.
    """

    def __init__(self, path: str | Path) -> None:
        """Read the file once.

        Raises:
            RecordingError: no recording, damaged, of two arms, or without tensions.
        """
        self.path = Path(path)
        if self.path.is_dir():
            raise RecordingError(f"{path}: is a folder; give the .mcap file in it")
        messages = McapMessages(self.path)
        names: dict[str, str] = {}
        self._calibrations: list[CalibrationMessage] = []
        self.answers: dict[int, bytes] = {}
        for raw in messages:
            topic = recorded_topic(raw.topic)
            if topic is None or topic == topics.SEGMENT_WRENCHES:
                continue
            self._check(topic, raw, names)
            if topic == topics.WRENCH:
                self.answers[_stamp(raw.data)] = raw.data
            if topic == topics.CALIBRATION_USED:
                self._calibrations.append(self._calibration(raw))
        for needed in (topics.CABLE_TENSIONS, topics.CALIBRATION_USED):
            if needed not in names:
                present = ", ".join(sorted(names.values())[:8]) or "nothing"
                raise RecordingError(
                    f"{path}: has no {needed}, but {present}; record with cablesense record while "
                    "an estimator of contacts anywhere runs"
                )
        self.cut = messages.cut

    def messages(self) -> Iterator[RawMessage | CalibrationMessage]:
        """Each message that answers rest on, in the order in which the estimator took them.

        That is the order of recording, but for calibrations: they come from the estimator and may
        be recorded before or behind the sample after which they hold.

        Raises:
            RecordingError: the file has become unreadable.
        """
        replayed = frozenset(filter(None, REPLAYED_FROM.values()))
        remaining = deque(self._calibrations)
        calibrated = False
        for raw in McapMessages(self.path):
            topic = recorded_topic(raw.topic)
            if topic == topics.CALIBRATION_USED and not calibrated:
                calibrated = True
                yield remaining.popleft()
            elif topic in replayed and topic != topics.CALIBRATION_USED:
                yield raw
            if topic == topics.CABLE_TENSIONS:
                stamp = _stamp(raw.data)
                while calibrated and remaining and remaining[0].beginning.after_ns <= stamp:
                    yield remaining.popleft()

    def _calibration(self, raw: RawMessage) -> CalibrationMessage:
        message: Any = parsed_message(raw)
        dimensions = message.layout.dim
        label = str(dimensions[0].label) if dimensions else ""
        try:
            provenance, beginning = Provenance.from_json(label)
        except ContractError as error:
            raise RecordingError(f"{self.path}: {raw.topic}: {error}") from error
        return CalibrationMessage(raw.topic, provenance, beginning, bytes(message.data))

    def _check(self, topic: str, raw: RawMessage, names: dict[str, str]) -> None:
        first = names.setdefault(topic, raw.topic)
        if raw.topic != first and not topic.startswith("/"):
            raise RecordingError(
                f"{self.path}: {first} and {raw.topic} are both {topic}; record one arm alone"
            )
        if raw.kind != RECORDED_TOPICS[topic].kind:
            raise RecordingError(
                f"{self.path}: {raw.topic} is of type {raw.kind[:80]!r}; it must be "
                f"{RECORDED_TOPICS[topic].kind}"
            )


def _stamp(raw: bytes) -> int:
    try:
        require_bounded(raw)
        return stamp_ns(raw)
    except ContractError:
        return 0


@dataclass
class Comparison:
    """Counts of a replay, and the first difference as text, if any.

    Attributes:
        samples: recorded.
        compared: those with a recorded answer that were answered again.
        identical: of these, whose wrenches are the same to the last bit.
        contacts: of those compared, with a force.
        not_replayed: those with a recorded answer that were not answered again: before the
            recording has a calibration, or without a stamp by which to find them.
    """

    samples: int = 0
    compared: int = 0
    identical: int = 0
    contacts: int = 0
    not_replayed: int = 0
    first_difference: str = ""

    def compare(self, recorded: bytes, replayed: bytes) -> None:
        """Compare the answers to the last sample."""
        self.compared += 1
        self.contacts += any(_numbers(recorded))
        if recorded == replayed:
            self.identical += 1
        elif not self.first_difference:
            self.first_difference = (
                f"sample {self.samples}, stamp {stamp_ns(recorded)}: {_numbers(recorded)} "
                f"recorded, {_numbers(replayed)} replayed"
            )

    @property
    def same(self) -> bool:
        """Whether there was something to compare, and no difference."""
        return 0 < self.compared == self.identical

    @property
    def lines(self) -> list[str]:
        """One line for each count, and the first difference."""
        rows = (
            (self.samples, "samples recorded"),
            (self.not_replayed, "not answered again: no calibration yet, or no stamp"),
            (self.compared, "compared"),
            (self.contacts, "of these contacts"),
            (self.identical, "bit-identical"),
        )
        lines = [f"{count:>10,}  {meaning}" for count, meaning in rows]
        if self.first_difference:
            lines.append(f"first difference: {self.first_difference}")
        return lines


def _numbers(raw: bytes) -> tuple[float, ...]:
    """Force and torque of a serialized `WrenchStamped`, zero where unknown; else none."""
    size = _WRENCH_NUMBERS.size
    numbers = _WRENCH_NUMBERS.unpack(raw[-size:]) if len(raw) >= size else ()
    return tuple(0.0 if math.isnan(number) else number for number in numbers)


class ReplayedAnswer(NamedTuple):
    """The answer to a recorded sample.

    Attributes:
        stamp_ns: of the sample.
        answer: what is stated again.
        wrench: the same as serialized `WrenchStamped`; empty where none is published.
        segment_count: of the arm.
    """

    stamp_ns: int
    answer: Answer
    wrench: bytes
    segment_count: int


class RebuiltEstimator:
    """The estimator of a recording, with the recorded model or another arm or model.

    Attributes:
        placed: its links in their message frames, from the first calibration on.
    """

    def __init__(self, run: RecordedRun, arm: str = "", model: str = "") -> None:
        self._run = run
        self._arm = arm
        self._model = model
        self._loaded: Loaded | None = None
        self._estimation: Estimation | None = None
        self._writers: list[WrenchWriter] = []
        self.placed = PlacedLinks(None)
        self._unknown_force = "zero"

    def take(self, raw: RawMessage | CalibrationMessage) -> ReplayedAnswer | None:
        """Take one message over; gives the answer to a sample, None without one.

        Raises:
            RecordingError: a calibration that cannot be read.
            CableSenseError: the model is missing or has changed since.
        """
        if isinstance(raw, CalibrationMessage):
            self._calibrate(raw)
            return None
        topic = recorded_topic(raw.topic) or ""
        if self._estimation is None or self._loaded is None:
            return None
        if topic == topics.CABLE_TENSIONS:
            return self._answer(raw.data)
        measured = self._loaded.machine.reads_joints
        take: Callable[[Any], object]
        match topic:
            case topics.CABLE_OFFSETS:
                take = self._estimation.offset
            case topics.JOINT_STATES if measured:
                take = self._estimation.command
            case topics.JOINT_COMMANDS if not measured:
                take = self._estimation.command
            case topics.JOINT_STATES | topics.JOINT_COMMANDS:
                return None  # nor did the live estimator take it
            case _:
                raise ContractError(
                    f"topic {topic} stands in REPLAYED_FROM, and no case here takes it; add one"
                )
        with suppress(CableSenseError):  # the live estimator refused it too
            take(parsed_message(raw))
        return None

    def _calibrate(self, message: CalibrationMessage) -> None:
        provenance = message.provenance
        if self._estimation is None:
            self._loaded = self._load(provenance)
            loaded = self._loaded
            contacts = loaded.contacts(provenance.settings)
            self._estimation = Estimation(loaded.machine, contacts, provenance.settings, 0.0)
            frames = contact_frames(loaded.machine, provenance.frame_prefix)
            self._writers = wrench_writers(frames)
            self.placed = PlacedLinks(loaded.machine.link_frames)
            self._unknown_force = provenance.settings.unknown_force
        assert self._loaded is not None
        settings = provenance.settings
        self._estimation.adjust(**{name: getattr(settings, name) for name in LIVE_SETTINGS})
        calibration = calibration_of(message.content, self._loaded.machine, message.topic)
        command_rad = np.array(message.beginning.command_rad)
        self._estimation.restore(calibration, command_rad, known=message.beginning.known)

    def _answer(self, sample: bytes) -> ReplayedAnswer | None:
        assert self._estimation is not None
        assert self._loaded is not None
        stamp = _stamp(sample)
        if not stamp:
            return None
        answer = self._estimation.sample(sample, stamp, stamp * 1e-9)
        wrench = answer.wrench(self._unknown_force)
        segment = answer.contact.segment
        written = b""
        if wrench is not None:
            in_frame = self.placed.wrench(segment, wrench)
            written = bytes(self._writers[segment].write(stamp, in_frame))
        return ReplayedAnswer(stamp, answer, written, len(self._loaded.machine.link_names))

    def _load(self, provenance: Provenance) -> Loaded:
        if self._arm:
            return load(self._arm, self._model)
        if self._model:
            return LoadedModel.open(find_model(self._model))
        recorded_path = Path(provenance.model)
        path = recorded_path if recorded_path.is_file() else find_model(recorded_path.stem)
        machine_file = path.with_suffix(".yaml")  # beside its model, as the estimator found it
        if is_machine_file(machine_file):
            loaded = load(str(machine_file), str(path))
        else:
            loaded = LoadedModel.open(path)
        if loaded.sha256 != provenance.sha256:
            raise RecordingError(
                f"the recording is of a model {recorded_path.name} with SHA-256 "
                f"{provenance.sha256[:12]}…, and {loaded.path} is another; name it with --model"
            )
        return loaded


def replay_in_process(
    run: RecordedRun, arm: str = "", model: str = "", estimates: Path | None = None
) -> Comparison:
    """Answer every recorded sample again, and compare with the recorded answers.

    Commands and samples are taken in the order of recording. Where a command and a sample came at
    the same moment, the live estimator may have taken them in the other order; the arm then moves,
    and there is no estimate.

    Args:
        run: the recording.
        arm: one other than the recorded one, or empty.
        model: as `arm`.
        estimates: a CSV file for the answers, numbers with all their digits. `segment` is 0
            without a contact; `problem` says why a sample was refused.

    Raises:
        RecordingError: the recording lacks what a replay needs, or `estimates` cannot be written.
        CableSenseError: the model is not to be found, or does not fit.
    """
    comparison = Comparison()
    rebuilt = RebuiltEstimator(run, arm, model)
    answers = _compared(run, rebuilt, comparison)
    if estimates is None:
        for _ in answers:
            pass
        return comparison
    with (
        written_whole(estimates, RecordingError) as partial,
        partial.open("w", encoding="utf-8", newline="") as file,
    ):
        table = csv.writer(file, lineterminator="\n")
        for number, replayed in enumerate(answers):
            if number == 0:
                segments = [f"p_segment_{n + 1}" for n in range(replayed.segment_count)]
                head = ("stamp_ns", *ANSWER_COLUMNS, "p_none")
                table.writerow([*head, *segments, "problem"])
            table.writerow(_row(replayed, rebuilt.placed))
    return comparison


def _row(replayed: ReplayedAnswer, links: PlacedLinks) -> list[object]:
    answer = replayed.answer
    probabilities = answer.probabilities or ("",) * (replayed.segment_count + 1)
    problem = "" if answer.problem is None else answer.problem.kind.value
    return [replayed.stamp_ns, *answer_cells(answer, links), *probabilities, problem]


def _compared(
    run: RecordedRun, rebuilt: RebuiltEstimator, comparison: Comparison
) -> Iterator[ReplayedAnswer]:
    """The answers to samples that the recording has answers to."""
    for message in run.messages():
        replayed = rebuilt.take(message)
        if recorded_topic(message.topic) != topics.CABLE_TENSIONS:
            continue
        comparison.samples += 1
        assert isinstance(message, RawMessage)
        recorded = run.answers.get(_stamp(message.data))
        if recorded is None and run.answers:
            continue
        if replayed is None:
            comparison.not_replayed += recorded is not None
            continue
        if recorded is not None:
            comparison.compare(recorded, replayed.wrench)
        yield replayed
