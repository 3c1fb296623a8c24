"""A recorded run through the same `Estimation`, as fast as it goes.

The `Estimation` that a journal entry speaks of, built again from its model and settings.

Answers of a replay beside the recorded ones, byte by byte.

A comparison in words, for people.

Estimates as CSV: one row a sample.
"""

from __future__ import annotations

import csv
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, TextIO, get_type_hints

from cablesense_base.files import written_whole
from cablesense_gap.recordings.recording import RecordingError
from cablesense_msgs_py.journal import JournalEntry
from cablesense_msgs_py.serialized import WrenchWriter, stamp_ns, wrench_writers
from cablesense_msgs_py.topics import ContractError, Frames
from cablesense_online.answers import LoadedModel, Outcome, load_model
from cablesense_online.estimation import Estimation
from cablesense_online.journal import EstimationSettings
from cablesense_online.recorded_run import RecordedRun, shows_contact
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.temporal_estimator import open_estimator

LIVE_SETTINGS = ("contact_threshold", "stale_after_s", "slack_below_n")
"""Those that may change while an estimator runs."""


class RebuiltEstimation:
    """Follows the journal, and answers samples as serialized wrenches.

    Attributes:
        outcome: of the last sample.
    """

    def __init__(self, arm: str, model: str) -> None:
        """With the recorded model, or with another `arm` or `model` where one is given."""
        self._arm, self._model = arm, model
        self._loaded: LoadedModel | None = None
        self._built_for: tuple[str, Mapping[str, str]] | None = None
        self._estimation: Estimation | None = None
        self._described: dict[str, str] = {}
        self._writers: list[WrenchWriter] = []
        self.outcome = Outcome()

    @property
    def loaded(self) -> LoadedModel | None:
        """Arm and model; none before the first entry."""
        return self._loaded

    @property
    def vouches(self) -> bool:
        """Whether the answers must be those of the recording."""
        return self._estimation is not None and self._estimation.vouches

    def follow(self, entry: JournalEntry) -> None:
        """Be in the state that the entry tells.

        Raises:
            CableSenseError: the model is not to be found, or has changed since; settings that
                cannot be; an entry of another arm.
        """
        fixed = {name: of for name, of in entry.settings.items() if name not in LIVE_SETTINGS}
        wanted = (entry.arm, fixed)
        settings = _settings(entry.settings)
        if self._estimation is None or wanted != self._built_for:
            self._build(entry, settings)
            self._built_for = wanted
        assert self._estimation is not None
        self._estimation.adjust(**{name: getattr(settings, name) for name in LIVE_SETTINGS})
        self._estimation.restore(entry)

    def answer(self, sample: bytes, stamp_ns: int) -> bytes:
        """The wrench that a sample with this stamp gets."""
        assert self._estimation is not None
        self.outcome = self._estimation.sample(sample, stamp_ns, stamp_ns * 1e-9)
        contact = self.outcome.contact
        return self._writers[contact.segment].write(stamp_ns, contact.wrench)

    def _build(self, entry: JournalEntry, settings: EstimationSettings) -> None:
        self._loaded = self._load(entry)
        prefix = entry.settings.get("frame_prefix", "")
        self._writers = wrench_writers(Frames(self._loaded.arm.segment_count, prefix))
        self._estimation = Estimation(self._loaded.arm, self._loaded.estimator, settings, 0.0)

    def _load(self, entry: JournalEntry) -> LoadedModel:
        described = {key: entry.settings.get(key, "") for key in ("model", "model SHA-256")}
        if self._loaded is not None and described == self._described:
            return self._loaded
        self._described = described
        if self._arm or self._model:
            if self._arm:
                return load_model(self._arm, self._model)
            return _load_alone(find_model(self._model))
        path = Path(entry.settings.get("model", ""))
        loaded = _load_alone(path if path.is_file() else find_model(path.stem))
        recorded = entry.settings.get("model SHA-256", "")
        if loaded.described["model SHA-256"] != recorded:
            raise RecordingError(
                f"the recording is of a model {path.name} with SHA-256 {recorded[:12]}…, and "
                f"{loaded.model} is another; name the model with --model"
            )
        return loaded


def _load_alone(path: Path) -> LoadedModel:
    estimator = open_estimator(path)
    return LoadedModel(estimator.metadata.arm, estimator, str(path))


def _settings(texts: Mapping[str, str]) -> EstimationSettings:
    """The settings from text."""
    values: dict[str, Any] = {}
    for name, kind in get_type_hints(EstimationSettings).items():
        text = texts.get(name, "")
        if kind is bool:
            values[name] = text == "True"
            continue
        try:
            values[name] = kind(text)
        except ValueError as error:
            raise RecordingError(f"journal: {name} is {text[:40]!r}, no number") from error
        if not isfinite(values[name]) or values[name] < 0:
            raise RecordingError(f"journal: {name} is {text}; it must be finite and not negative")
    if not 1 <= values["tare_samples"] <= 10_000 or values["joint_speed_rad_s"] == 0.0:
        raise RecordingError("journal: tare_samples must be 1 to 10000, and joints must move")
    return EstimationSettings(**values)


@dataclass
class Comparison:
    """Counts, and the first difference in words.

    Attributes:
        samples: recorded, with a stamp.
        compared: those whose answer is recorded and whose state the journal tells.
        identical: those of which every byte of the wrench is the same.
        contacts: those compared whose recorded answer is a contact.
        unanswered: of which the estimator took no notice.
        before_journal: answered, but the recording does not say what the answers rest on.
        unstamped, lone_contacts, lone_zeros: as in `AnsweredSamples`.
        first_difference: empty where there is none.
    """

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

    def compare(self, number: int, recorded: bytes, replayed: bytes | None) -> None:
        """The answer to a sample; `replayed` is none where the replay gave none.

        Args:
            number: of the sample, from 1.
            recorded: serialized `WrenchStamped`.
            replayed: the same.
        """
        self.compared += 1
        self.contacts += shows_contact(recorded)
        if recorded == replayed:
            self.identical += 1
        elif not self.first_difference:
            there = "nothing" if replayed is None else _words(replayed)
            self.first_difference = (
                f"sample {number}, stamp {stamp_ns(recorded)}: {_words(recorded)} recorded, "
                f"{there} replayed"
            )

    @property
    def same(self) -> bool:
        """Whether there was something to compare, and no difference."""
        return 0 < self.compared == self.identical

    def as_json(self) -> dict[str, Any]:
        """The counts, for a machine."""
        return dict(vars(self))


def _words(raw: bytes) -> str:
    """Frame and numbers of a serialized `WrenchStamped`, or its bytes."""
    try:
        (length,) = struct.unpack_from("<I", raw, 12)
        frame = raw[16 : 16 + length].rstrip(b"\0").decode()
        numbers = " ".join(map(repr, struct.unpack("<6d", raw[-48:])))
    except (struct.error, UnicodeDecodeError, ContractError):
        return raw.hex()
    return f"{frame} {numbers}"


class EstimateTable:
    """Writes rows; numbers with all their digits."""

    def __init__(self, file: TextIO) -> None:
        self._rows = csv.writer(file, lineterminator="\n")
        self._begun = False

    def add(self, stamp_ns: int, outcome: Outcome, segment_count: int) -> None:
        """The answer to one sample of an arm with N segments.

        `segment` is 0 without a contact; probabilities are empty where nothing was estimated: in a
        move, before the first tare, at a sample of no use, whose `problem` is said then.
        """
        if not self._begun:
            self._begun = True
            beliefs = ["p_none", *(f"p_segment_{n + 1}" for n in range(segment_count))]
            self._rows.writerow(
                ["stamp_ns", "segment", "angle_deg", "magnitude_n", *beliefs, "problem"]
            )
        contact = outcome.contact
        beliefs = [*outcome.probabilities] or [""] * (segment_count + 1)  # type: ignore[list-item]
        problem = "" if outcome.problem is None else outcome.problem.kind.value
        touched = [contact.angle_deg, contact.magnitude_n] if contact.segment else ["", ""]
        self._rows.writerow([stamp_ns, contact.segment, *touched, *beliefs, problem])


@contextmanager
def estimate_table(path: Path) -> Iterator[EstimateTable]:
    """A table that stands under its name when it is whole.

    Raises:
        RecordingError: it cannot be written there.
    """
    with (
        written_whole(path, RecordingError) as beside,
        beside.open("w", encoding="utf-8", newline="") as file,
    ):
        yield EstimateTable(file)


def replay_in_process(
    run: RecordedRun, arm: str = "", model: str = "", table: EstimateTable | None = None
) -> Comparison:
    """Answer every recorded sample that the live estimator answered, and compare.

    The answers rest on the journal and the samples alone, so a bag that was played faster, read on
    another machine or begun in mid-move gives the same ones, as far as the processor's arithmetic
    and the versions of the libraries are the same.

    Args:
        run: the recording.
        arm: another than the recorded, or empty.
        model: another than the recorded, or empty.
        table: takes the answers, if any is wanted.

    Raises:
        RecordingError: the recording lacks what a replay needs.
        CableSenseError: the model is not to be found, or does not fit.
    """
    if not run.entries:
        raise RecordingError(
            f"{run.path}: has no ~/journal, and without it nobody knows the tare and the command "
            "at each sample; record with: cablesense record"
        )
    rebuilt = RebuiltEstimation(arm, model)
    comparison = Comparison()
    for entries, pair, taken in run.steps():
        comparison.samples += 1
        for entry in entries:
            rebuilt.follow(entry)
        if pair.answer is None:
            comparison.unanswered += 1
            if taken:  # a model with memory has heard it
                rebuilt.answer(pair.sample, pair.stamp_ns)
        elif rebuilt.loaded is None:
            comparison.before_journal += 1
        elif not rebuilt.vouches:
            rebuilt.answer(pair.sample, pair.stamp_ns)
            comparison.before_journal += 1
        else:
            answer = rebuilt.answer(pair.sample, pair.stamp_ns)
            comparison.compare(comparison.samples, pair.answer, answer)
            if table is not None:
                table.add(pair.stamp_ns, rebuilt.outcome, rebuilt.loaded.arm.segment_count)
    comparison.unstamped = run.pairs.unstamped
    comparison.lone_contacts = run.pairs.lone_contacts
    comparison.lone_zeros = run.pairs.lone_zeros
    return comparison


def comparison_lines(comparison: Comparison, cut: str) -> list[str]:
    """One line for each count that is not zero, the verdict, and the first difference.

    Args:
        comparison: the counts.
        cut: where the file breaks off, in words; empty if it is whole.
    """
    counted = {
        "samples recorded": comparison.samples,
        "not answered when recorded (no estimator, or refused by their stamp)": (
            comparison.unanswered
        ),
        "answered before the journal tells enough, so not compared": comparison.before_journal,
        "samples without a stamp, so not compared": comparison.unstamped,
        "contacts reported whose sample the recording lacks": comparison.lone_contacts,
        "zero wrenches of the estimator in a silence": comparison.lone_zeros,
        "compared": comparison.compared,
        "of these contacts": comparison.contacts,
        "bit-identical": comparison.identical,
    }
    always = ("samples recorded", "compared", "bit-identical")
    lines = [f"the file {cut}"] if cut else []
    lines += [
        f"{count:>10,}  {what}" for what, count in counted.items() if count or what in always
    ]
    if comparison.first_difference:
        lines.append(f"first difference: {comparison.first_difference}")
    return lines
