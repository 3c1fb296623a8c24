"""A recorded run, answered again by the same `Estimation` and compared with its own answers.

`replay_in_process` rebuilds the estimator of each recorded state and runs as fast as it can.
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
from cablesense_online.recorded_run import (
    WRENCH_NUMBERS,
    RecordedRun,
    RecordedSample,
    shows_contact,
)
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

    def compare(self, recorded: Mapping[int, bytes], replayed: Mapping[int, bytes]) -> None:
        """Compare the answers to the last sample; all that was recorded must be replayed."""
        self.compared += 1
        self.contacts += shows_contact(recorded[0])
        other = [of for of, raw in recorded.items() if replayed.get(of) != raw]
        if not other:
            self.identical += 1
        elif not self.first_difference:
            raw, again = recorded[other[0]], replayed.get(other[0])
            there = "nothing" if again is None else _wrench_text(again)
            self.first_difference = (
                f"sample {self.samples}, stamp {stamp_ns(raw)}: {_wrench_text(raw)} recorded, "
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
        numbers = " ".join(map(repr, WRENCH_NUMBERS.unpack(raw[-WRENCH_NUMBERS.size :])))
    except (struct.error, UnicodeDecodeError):
        return raw.hex()
    return f"{frame} {numbers}"


class RebuiltEstimation:
    """An estimation that goes from state to state and answers samples as serialized wrenches.

    Attributes:
        answer: the answer to the last sample.
        loaded: arm and model; None before the first state.
        reproducible: whether the answers must be those of the recording.
    """

    def __init__(self, arm: str, model: str) -> None:
        """With the recorded model, or with another `arm` or `model` if one is given."""
        self._arm, self._model = arm, model
        self.loaded: LoadedModel | None = None
        self.reproducible = False
        self._loaded_for: dict[str, str] = {}
        self._built_for: object = None
        self._estimation: Estimation | None = None
        self._writers: list[WrenchWriter] = []
        self._unknown_force = "zero"
        self.answer = Answer()

    def restore(self, state: EstimatorState) -> None:
        """Continue from a state.

        Raises:
            CableSenseError: the model is missing or has changed since, or the state is one of
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
        self.reproducible = self._estimation.reproducible

    def wrenches(self, sample: RecordedSample) -> dict[int, bytes]:
        """The wrenches that answer a sample, numbered as in `RecordedSample.answers`."""
        assert self._estimation is not None
        stamp = sample.stamp_ns
        self.answer = answer = self._estimation.sample(sample.sample, stamp, stamp * 1e-9)
        wrench, answers = answer.wrench(self._unknown_force), {}
        if wrench is not None:
            answers[0] = self._writers[answer.contact.segment].write(stamp, wrench)
        for number in sample.answers:
            wrench = answer.on_segment(number, self._unknown_force) if number else None
            if wrench is not None:
                answers[number] = self._writers[number].write(stamp, wrench)
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

    The answers rest on the journal and the samples alone. A recording that was played faster, read
    on another machine or started in mid-move gives the same answers, as far as the processor's
    arithmetic and the versions of the libraries are the same.

    Args:
        run: the recording.
        arm: an arm other than the recorded one, or empty.
        model: a model other than the recorded one, or empty.
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
    for sample in run.samples():
        comparison.samples += 1
        comparison.unanswered += not sample.answered
        for state in sample.states:
            rebuilt.restore(state)
        if not sample.taken and run.has_answers:
            continue
        if rebuilt.loaded is None:
            comparison.before_journal += sample.answered
            continue
        wrenches = rebuilt.wrenches(sample)
        if not sample.answered:
            continue  # a history-dependent model has received it
        if not rebuilt.reproducible:
            comparison.before_journal += 1
            continue
        comparison.compare(sample.answers, wrenches)
        yield sample.stamp_ns, rebuilt.answer, rebuilt.loaded.arm.segment_count
    comparison.unstamped = run.unstamped
    comparison.lone_contacts, comparison.lone_zeros = run.lone_contacts, run.lone_zeros


def comparison_lines(comparison: Comparison, cut: str) -> list[str]:
    """One line for each count that is not zero, the verdict, and the first difference.

    `cut` is where the file breaks off, as text; empty if it is whole.
    """
    lines = [f"the file {cut}"] if cut else []
    for name, meaning in COUNTED.items():
        count = getattr(comparison, name)
        if count or name in _ALWAYS_SHOWN:
            lines.append(f"{count:>10,}  {meaning}")
    if comparison.first_difference:
        lines.append(f"first difference: {comparison.first_difference}")
    return lines
