"""The `Estimation` that a journal entry speaks of, built again from its model and settings."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any, get_type_hints

from cablesense_gap.recordings.recording_error import RecordingError
from cablesense_msgs_py.frames import Frames
from cablesense_msgs_py.journal import JournalEntry
from cablesense_msgs_py.wrench_writer import WrenchWriter, wrench_writers
from cablesense_ros.estimation import Estimation
from cablesense_ros.estimation_settings import EstimationSettings
from cablesense_ros.loaded_model import LoadedModel, load_model
from cablesense_ros.outcome import Outcome
from cablesense_training.inference.model_files import find_model
from cablesense_training.inference.open_estimator import open_estimator

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
