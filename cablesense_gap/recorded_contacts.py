"""Known loads of a recording as contacts with a tare, and a model's errors on them."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.recordings.recording import Recording, RecordingError
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import loadings
from cablesense_sim.loads import normal_components_n
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    SingleContactMetrics,
    single_contact_metrics,
)
from cablesense_training.inference.estimator import Estimator, SequenceEstimator
from cablesense_training.inference.history_simulation import HistorySimulation

STEADY_N = 1.0
"""Standard deviation of a cable's readings above which the estimator node takes no tare."""


def tares_n(recording: Recording) -> Array:
    """(R, M) tare of every row that is loaded or released from a load; NaN where there is none.

    The mean of the unloaded rows just before the load, at its command; where these are not
    steady, as sensors that lag leave them, the tare before that at this command.
    """
    loaded = recording.load_segment > 0
    moved = (np.diff(recording.command_rad, axis=0, prepend=np.nan) != 0.0).any(axis=1)
    tare = np.full_like(recording.tensions_n, np.nan)
    latest: dict[bytes, Array] = {}
    first: int | None = None  # of the latest unloaded rows at the present command
    last = 0
    for row in range(len(recording)):
        if moved[row]:
            first = None
        if not loaded[row]:
            if first is None or loaded[row - 1]:
                first = row
            last = row
            if not moved[row]:  # a load that has gone leaves what it left; none leaves none
                tare[row] = tare[row - 1]
        elif loaded[row - 1] and not moved[row]:
            tare[row] = tare[row - 1]
        else:
            command = recording.command_rad[row].tobytes()
            if first is not None:
                before = recording.tensions_n[first : last + 1]
                if before.std(axis=0).max() <= STEADY_N:
                    latest[command] = before.mean(axis=0)
            tare[row] = latest.get(command, np.nan)
    return tare


def tares_from_before(recording: Recording, tare_n: Array) -> Array:
    """(R, M) tares that begin one row sooner, where the arm is unloaded at the same command.

    What depends on history then has seen the unloaded arm when the load comes.
    """
    still = (np.diff(recording.command_rad, axis=0) == 0.0).all(axis=1)
    begins = (tare_n[1:] != tare_n[:-1]).any(axis=1) & np.isfinite(tare_n[1:]).all(axis=1)
    before = np.flatnonzero(begins & still & (recording.load_segment[:-1] == 0))
    found = tare_n.copy()
    found[before] = tare_n[before + 1]
    return found


def with_acting_loads(recording: Recording, arm: Arm) -> Recording:
    """The recording with the loads that acted, by what an arm lists of its load cell."""
    load_n = recording.load_n
    for matrix in loadings([entries_of(arm)]):
        load_n = load_n @ matrix[0].T
    return replace(recording, load_n=load_n)


class RecordedErrors(NamedTuple):
    """A model's answers on the contacts of a recording, and their errors.

    Attributes:
        truth: loads, the part that can be felt, and released rows as no contact.
        answer: the model's.
        whole: errors over all rows.
        by_segment: errors over the rows with a load on each segment, by its number.
        false_n: mean force estimated in rows without a load; NaN without such rows.
    """

    truth: ContactTruth
    answer: ContactAnswer
    whole: SingleContactMetrics
    by_segment: dict[int, SingleContactMetrics]
    false_n: float

    def as_json(self) -> dict[str, Any]:
        """Errors as plain values."""
        return {
            "all": asdict(self.whole),
            "by_segment": {str(n): asdict(each) for n, each in self.by_segment.items()},
            "false_force_n": self.false_n,
        }


Answering = Callable[[Recording, Array, NDArray[np.bool_]], ContactAnswer]
"""From a recording, its tares (R, M) and rows (R,) to the answers on these rows."""


def recorded_errors(
    recording: Recording,
    estimator: Estimator | SequenceEstimator,
    trials: Collection[int] | None = None,
) -> RecordedErrors:
    """The errors of a model on a recording of its arm, or on the contacts of some of its trials.

    Raises:
        RecordingError: no load follows unloaded rows at its command, so there is no tare.
    """

    def at_once(recording: Recording, tare_n: Array, rows: NDArray[np.bool_]) -> ContactAnswer:
        assert isinstance(estimator, Estimator)
        difference_n = (recording.tensions_n - tare_n)[rows]
        found = estimator.estimate_batch(difference_n, recording.command_rad[rows])
        return ContactAnswer.of(found)

    def along(recording: Recording, tare_n: Array, rows: NDArray[np.bool_]) -> ContactAnswer:
        assert isinstance(estimator, SequenceEstimator)
        return _along(recording, tare_n, estimator).select(rows)

    answering = along if isinstance(estimator, SequenceEstimator) else at_once
    return contact_errors(recording, estimator.metadata.arm, answering, trials)


def contact_errors(
    recording: Recording,
    arm: Arm,
    answering: Answering,
    trials: Collection[int] | None = None,
) -> RecordedErrors:
    """Errors of answers on the contacts of a recording; otherwise as `recorded_errors`."""
    tare = tares_n(recording)
    rows = np.asarray(np.isfinite(tare).all(axis=1))
    if trials is not None:
        rows &= np.isin(recording.trial, list(trials))
    if not (rows & (recording.load_segment > 0)).any():
        raise RecordingError(
            f"{recording.name}: no load follows unloaded rows at its command, so there is no tare "
            "to estimate from; record load cycles (cablesense gap protocol)"
        )
    answer, taken = answering(recording, tare, rows), recording.rows(rows)
    y, z = normal_components_n(
        mechanism_of(arm), taken.command_rad, np.maximum(taken.load_segment, 1), taken.load_n
    )
    truth = ContactTruth(taken.load_segment, np.rad2deg(np.arctan2(y, z)) % 360.0, np.hypot(y, z))

    def errors(chosen: NDArray[np.bool_]) -> SingleContactMetrics:
        return single_contact_metrics(
            truth.select(chosen), answer.select(chosen), arm.segment_count
        )

    free = truth.segment == 0
    false_n = answer.force_n[free]
    return RecordedErrors(
        truth,
        answer,
        errors(np.ones(len(taken), dtype=bool)),
        {int(n): errors(truth.segment == n) for n in np.unique(truth.segment) if n},
        float(false_n.mean()) if false_n.size else float("nan"),
    )


def without_history_n(
    recording: Recording, tare_n: Array, simulation: HistorySimulation
) -> tuple[Array, Array]:
    """Tension differences (R, M) from tares (R, M) as they would be without the arm's history.

    NaN where there is no tare. Beside them what may be hidden (R, 2) of the load, N, along it and
    across it.
    """
    tare_n = tares_from_before(recording, tare_n)
    tared = np.asarray(np.isfinite(tare_n).all(axis=1))
    simulation.forget()
    found, hidden_n = recording.tensions_n - tare_n, np.zeros((len(recording), 2))
    for row, command_rad in enumerate(recording.command_rad):
        time_s = float(recording.time_s[row])
        if not (tared[row] and row and (tare_n[row] == tare_n[row - 1]).all()):
            simulation.unloaded(time_s, command_rad)
        if tared[row]:
            found[row] = simulation.without_n(found[row], time_s, command_rad)
            hidden_n[row] = simulation.hidden_n
    return found, hidden_n


def _along(recording: Recording, tare_n: Array, estimator: SequenceEstimator) -> ContactAnswer:
    """Answers on all rows (R,), row after row, each tare (R, M) taken when it counts first."""
    tare_n = tares_from_before(recording, tare_n)
    tared = np.asarray(np.isfinite(tare_n).all(axis=1))
    still = np.zeros(recording.command_rad.shape[1])
    estimator.forget()
    found = []
    for row, command_rad in enumerate(recording.command_rad):
        difference_n = np.zeros(tare_n.shape[1])
        if not (tared[row] and row and (tare_n[row] == tare_n[row - 1]).all()):
            estimator.tare()
        if tared[row]:
            difference_n = recording.tensions_n[row] - tare_n[row]
        time_s = float(recording.time_s[row])
        found.append(estimator.estimate(difference_n, command_rad, still, still, time_s))
    return ContactAnswer(
        *(np.array([getattr(each, part.name) for each in found]) for part in fields(ContactAnswer))
    )
