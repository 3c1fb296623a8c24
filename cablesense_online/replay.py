"""A recorded run answered again by the same `Estimation`, and compared with the recorded answers.

`replay_in_process` rebuilds the estimator of each recorded state from its model and settings, and
runs as fast as it can.
"""

from __future__ import annotations

import csv
import struct
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cablesense_base.files import written_whole
from cablesense_gap.recordings.recording import RecordingError
from cablesense_msgs_py.serialized import WrenchWriter, stamp_ns, wrench_writers
from cablesense_msgs_py.topics import Frames
from cablesense_online.answer import Answer
from cablesense_online.estimation import Estimation
from cablesense_online.models import LoadedModel, load_model
from cablesense_online.recorded_run import RecordedRun, Step, shows_contact
from cablesense_online.state import LIVE_SETTINGS, EstimatorState
from cablesense_training.inference.metadata import find_model

COUNTED: Final = {
    "samples": "samples recorded",
    "unanswered": "not answered when recorded (no estimator, or refused by their stamp)",
    "before_journal": "answered before the journal has a usable state, so not compared",
    "unstamped": "samples without a stamp, so not compared",
    "lone_contacts": "contacts whose sample is not in the recording",
    "lone_zeros": "zero wrenches of the estimator in a silence",
    "compared": "compared",
    "contacts": "of these contacts",
    "identical": "bit-identical",
}
_ALWAYS_SHOWN: Final = ("samples", "compared", "identical")


@dataclass
class Comparison:
    """Counts, with their meanings in `COUNTED`, and the first difference as text, if any."""

    samples: int = 0
    compared: int = 0
    identical: int = 0
    contacts: int = 0
    unanswered: int = 0
    before_journal: int = 0
    unstamped: int = 0
    lone_contacts: int = 0
    lone_zeros: int = 0
    first_difference: str = ""

    def compare(
        self, number: int, recorded: Mapping[int, bytes], replayed: Mapping[int, bytes]
    ) -> None:
        """Compare the answers to the sample `number`, from 1, as `Step.answers` has them.

        All that was recorded must have been replayed.
        """
        self.compared += 1
        self.contacts += shows_contact(recorded[0])
        other = [of for of, raw in recorded.items() if replayed.get(of) != raw]
        if not other:
            self.identical += 1
        elif not self.first_difference:
            raw, again = recorded[other[0]], replayed.get(other[0])
            there = "nothing" if again is None else _wrench_text(again)
            self.first_difference = (
                f"sample {number}, stamp {stamp_ns(raw)}: {_wrench_text(raw)} recorded, "
                f"{there} replayed"
            )

    @property
    def same(self) -> bool:
        """Whether there was something to compare, and no difference."""
        return 0 < self.compared == self.identical


def _wrench_text(raw: bytes) -> str:
    """Frame and numbers of a serialized `WrenchStamped`, or its bytes."""
    try:
        (length,) = struct.unpack_from("<I", raw, 12)
        frame = raw[16 : 16 + length].rstrip(b"\0").decode()
        numbers = " ".join(map(repr, struct.unpack("<6d", raw[-48:])))
    except (struct.error, UnicodeDecodeError):
        return raw.hex()
    return f"{frame} {numbers}"


def replayed_steps(
    run: RecordedRun, comparison: Comparison
) -> Iterator[tuple[list[EstimatorState], Step]]:
    """The samples that the recorded estimator took, each with the states since the one before.

    All samples are counted in `comparison`. A recording without answers gives every sample.
    """
    states: list[EstimatorState] = []
    for step in run.steps():
        comparison.samples += 1
        comparison.unanswered += not step.answered
        states += step.states
        if step.taken or not run.has_answers:
            yield states, step
            states = []
    comparison.unstamped = run.unstamped
    comparison.lone_contacts = run.lone_contacts
    comparison.lone_zeros = run.lone_zeros


class RebuiltEstimation:
    """Goes from state to state, and answers samples as serialized wrenches.

    Attributes:
        answer: to the last sample.
        loaded: arm and model; none before the first state.
    """

    def __init__(self, arm: str, model: str) -> None:
        """With the recorded model, or with another `arm` or `model` where one is given."""
        self._arm, self._model = arm, model
        self.loaded: LoadedModel | None = None
        self._loaded_for: dict[str, str] = {}
        self._built_for: object = None
        self._estimation: Estimation | None = None
        self._writers: list[WrenchWriter] = []
        self._unknown_force = "zero"
        self.answer = Answer()

    @property
    def reproducible(self) -> bool:
        """Whether the answers must be those of the recording."""
        return self._estimation is not None and self._estimation.reproducible

    def restore(self, state: EstimatorState) -> None:
        """Continue from a state.

        Raises:
            CableSenseError: the model is not to be found, or has changed since; a state of
                another arm.
        """
        fixed = state.settings.model_dump(exclude=set(LIVE_SETTINGS))
        wanted = (state.arm, state.origin, fixed)
        if self._estimation is None or wanted != self._built_for:
            self.loaded = self._load(state.origin)
            prefix = state.origin.get("frame_prefix", "")
            self._writers = wrench_writers(Frames(self.loaded.arm.segment_count, prefix))
            self._estimation = Estimation(
                self.loaded.arm, self.loaded.estimator, state.settings, 0.0
            )
            self._unknown_force = state.settings.unknown_force
            self._built_for = wanted
        self._estimation.adjust(**{name: getattr(state.settings, name) for name in LIVE_SETTINGS})
        self._estimation.restore(state)

    def wrenches(self, step: Step) -> dict[int, bytes]:
        """The wrenches that answer a sample, as `Step.answers` has those that were recorded."""
        assert self._estimation is not None
        stamp_ns = step.stamp_ns
        self.answer = answer = self._estimation.sample(step.sample, stamp_ns, stamp_ns * 1e-9)
        wrench, answers = answer.wrench(self._unknown_force), {}
        if wrench is not None:
            answers[0] = self._writers[answer.contact.segment].write(stamp_ns, wrench)
        for number in step.answers:
            wrench = answer.on_segment(number, self._unknown_force) if number else None
            if wrench is not None:
                answers[number] = self._writers[number].write(stamp_ns, wrench)
        return answers

    def _load(self, origin: dict[str, str]) -> LoadedModel:
        recorded = {key: origin.get(key, "") for key in ("model", "model SHA-256")}
        if self.loaded is not None and recorded == self._loaded_for:
            return self.loaded
        self._loaded_for = recorded
        if self._arm:
            return load_model(self._arm, self._model)
        if self._model:
            return LoadedModel.open(find_model(self._model))
        path, digest = Path(recorded["model"]), recorded["model SHA-256"]
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

    The answers rest on the journal and the samples alone, so a bag that was played faster, read on
    another machine or begun in mid-move gives the same ones, as far as the processor's arithmetic
    and the versions of the libraries are the same.

    `arm` and `model` are others than the recorded, or empty. `estimates` is a CSV file for the
    answers, numbers with all their digits: `segment` is 0 without a contact; probabilities are
    empty where nothing was estimated: in a move, before the first tare, and at a sample that was
    refused, whose `problem` is given.

    Raises:
        RecordingError: the recording has not all that a replay needs, or `estimates` cannot be
            written.
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
        written_whole(estimates, RecordingError) as beside,
        beside.open("w", encoding="utf-8", newline="") as file,
    ):
        table = csv.writer(file, lineterminator="\n")
        for number, (stamp, answer, segment_count) in enumerate(compared):
            if number == 0:
                segments = [f"p_segment_{n + 1}" for n in range(segment_count)]
                head = ("stamp_ns", "segment", "angle_deg", "magnitude_n", "p_none")
                table.writerow([*head, *segments, "problem"])
            contact = answer.contact
            touched = (contact.angle_deg, contact.magnitude_n) if contact.segment else ("", "")
            probabilities = answer.probabilities or ("",) * (segment_count + 1)
            problem = "" if answer.problem is None else answer.problem.kind.value
            table.writerow([stamp, contact.segment, *touched, *probabilities, problem])
    return comparison


def _compared(
    run: RecordedRun, rebuilt: RebuiltEstimation, comparison: Comparison
) -> Iterator[tuple[int, Answer, int]]:
    """Stamp, answer and number of segments of each sample that was compared."""
    for states, step in replayed_steps(run, comparison):
        for state in states:
            rebuilt.restore(state)
        if rebuilt.loaded is None:
            comparison.before_journal += step.answered
            continue
        wrenches = rebuilt.wrenches(step)
        if not step.answered:
            continue  # a history-dependent model has received it
        if not rebuilt.reproducible:
            comparison.before_journal += 1
            continue
        comparison.compare(comparison.samples, step.answers, wrenches)
        yield step.stamp_ns, rebuilt.answer, rebuilt.loaded.arm.segment_count


def comparison_lines(comparison: Comparison, cut: str) -> list[str]:
    """One line for each count that is not zero, the verdict, and the first difference.

    `cut` is where the file breaks off, as text; empty if it is whole.
    """
    counts = {name: getattr(comparison, name) for name in COUNTED}
    lines = [f"the file {cut}"] if cut else []
    lines += [
        f"{count:>10,}  {COUNTED[name]}"
        for name, count in counts.items()
        if count or name in _ALWAYS_SHOWN
    ]
    if comparison.first_difference:
        lines.append(f"first difference: {comparison.first_difference}")
    return lines
