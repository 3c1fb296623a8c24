"""Known loads of a recording as contacts with a tare, and a model's errors on them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import asdict, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.recordings.recording import SAME_PLACE_M, Recording, RecordingError
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.contact_location import Location
from cablesense_sim.effects.registry import amended, loadings
from cablesense_sim.loads import normal_components_n
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    SingleContactMetrics,
    single_contact_metrics,
)
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import Estimator, SequenceEstimator
from cablesense_training.inference.history_simulation import HistorySimulation

_STEADY_N = 1.0
"""Standard deviation of a cable's readings above which the estimator node takes no tare."""


def tares_n(recording: Recording) -> Array:
    """(R, M) tare of every row that is loaded or released from a load; NaN where there is none.

    A tare is the mean of the unloaded rows just before the load, at its command. If these are not
    steady, as with sensors that lag, the earlier tare at this command is used.
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
            if not moved[row]:  # a released row keeps the tare of its load
                tare[row] = tare[row - 1]
        elif loaded[row - 1] and not moved[row]:
            tare[row] = tare[row - 1]
        else:
            command = recording.command_rad[row].tobytes()
            if first is not None:
                before = recording.tensions_n[first : last + 1]
                if before.std(axis=0).max() <= _STEADY_N:
                    latest[command] = before.mean(axis=0)
            tare[row] = latest.get(command, np.nan)
    return tare


def at_contact_points(recording: Recording, arm: Arm) -> NDArray[np.bool_]:
    """(R,) rows without a load, or with it at the arm's contact point, where models assume it."""
    if recording.load_at_m is None:
        return np.ones(len(recording), dtype=bool)
    contact_m = mechanism_of(arm).contact_m[np.maximum(recording.load_segment, 1) - 1]
    elsewhere = np.abs(recording.load_at_m - contact_m) > SAME_PLACE_M
    return ~elsewhere | (recording.load_segment == 0)


def loads_at_m(recording: Recording, arm: Arm) -> Array:
    """(R,) where each load acts on its segment, from the joint centre; the arm file's by default.

    Rows without a load have that of segment 1.
    """
    mechanism = amended(mechanism_of(arm), entries_of(arm))
    usual_m = mechanism.contact_m[np.maximum(recording.load_segment, 1) - 1]
    return usual_m if recording.load_at_m is None else recording.load_at_m


def answer_at(found: Location, segment: NDArray[np.int64], at_m: Array) -> ContactAnswer:
    """Contacts anywhere as answers on loads on known segments (B,), at known places (B,).

    Where the tensions determine the moment alone, the force is the one at that place.
    """
    known = found.force_known | (found.segment != segment)
    there, to_force = at_m[:, None], [1.0, -1.0]  # a moment around z is due to y, around -y to z
    force_n = np.where(
        known[:, None], found.force_n[:, 1:], found.moment_n_m[:, ::-1] * to_force / there
    )
    std_n = np.where(
        known[:, None], found.force_std_n[:, 1:], found.moment_std_n_m[:, ::-1] / there
    )
    (y, z), (y_std, z_std) = force_n.T, std_n.T
    size_n = np.maximum(np.hypot(y, z), 1e-9)
    return ContactAnswer(
        segment=found.segment,
        angle_deg=np.rad2deg(np.arctan2(y, z)) % 360.0,
        magnitude_n=size_n,
        magnitude_std_n=np.hypot(y * y_std, z * z_std) / size_n,
        angle_std_deg=np.rad2deg(np.arctan(np.hypot(z * y_std, y * z_std) / size_n**2)),
    )


def _rows_with_tares(
    recording: Recording, tare_n: Array
) -> Iterator[tuple[Array | None, Array, float, bool]]:
    """Tension difference (M,), command, time, and whether the tare is no longer the same.

    The difference is None without a tare. A tare begins one row sooner than in `tare_n` (R, M) if
    the arm is unloaded there at the same command: history-dependent models then see the unloaded
    arm before the load.
    """
    still = (np.diff(recording.command_rad, axis=0) == 0.0).all(axis=1)
    begins = (tare_n[1:] != tare_n[:-1]).any(axis=1) & np.isfinite(tare_n[1:]).all(axis=1)
    before = np.flatnonzero(begins & still & (recording.load_segment[:-1] == 0))
    tares = tare_n.copy()
    tares[before] = tare_n[before + 1]
    tared = np.asarray(np.isfinite(tares).all(axis=1))
    for row, command_rad in enumerate(recording.command_rad):
        kept = tared[row] and row > 0 and (tares[row] == tares[row - 1]).all()
        difference_n = recording.tensions_n[row] - tares[row] if tared[row] else None
        yield difference_n, command_rad, float(recording.time_s[row]), not kept


def with_acting_loads(recording: Recording, arm: Arm) -> Recording:
    """The recording with the loads that acted, given the errors that an arm lists of its cell."""
    load_n = recording.load_n
    for matrix in loadings([entries_of(arm)]):
        load_n = load_n @ matrix[0].T
    return replace(recording, load_n=load_n)


class RecordedErrors(NamedTuple):
    """A model's answers on the contacts of a recording, and their errors.

    Attributes:
        truth: the parts of the loads that cables can feel; released rows are no contact.
        answer: the model's answers.
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
    anywhere: bool | None = None,
) -> RecordedErrors:
    """The errors of a model on the contacts of a recording of its arm, or of some trials.

    Loads elsewhere than at the arm file's contact points count if they may be `anywhere`, by
    default as the model knows them. For a model of contacts anywhere see `answer_at`.

    Raises:
        RecordingError: no load at a contact point follows unloaded rows at its command, so there
            is no tare.
    """

    def answering(recording: Recording, tare_n: Array, rows: NDArray[np.bool_]) -> ContactAnswer:
        if isinstance(estimator, SequenceEstimator):
            return _along(recording, tare_n, estimator).select(rows)
        difference_n = (recording.tensions_n - tare_n)[rows]
        command_rad = recording.command_rad[rows]
        if isinstance(estimator, AnywhereEstimator):
            located, _ = estimator.locate_batch(difference_n, command_rad)
            return answer_at(
                located, recording.load_segment[rows], loads_at_m(recording, arm)[rows]
            )
        return ContactAnswer.of(estimator.estimate_batch(difference_n, command_rad))

    arm = estimator.metadata.arm
    if anywhere is None:
        anywhere = isinstance(estimator, AnywhereEstimator)
    return contact_errors(recording, arm, answering, trials, anywhere)


def contact_errors(
    recording: Recording,
    arm: Arm,
    answering: Answering,
    trials: Collection[int] | None = None,
    anywhere: bool = False,
) -> RecordedErrors:
    """Errors of answers on the contacts of a recording; otherwise as `recorded_errors`.

    Loads elsewhere than at the arm file's contact points count only if they may be `anywhere`.
    """
    tare = tares_n(recording)
    rows: NDArray[np.bool_] = np.asarray(np.isfinite(tare).all(axis=1))
    if not anywhere:
        rows &= at_contact_points(recording, arm)
    if trials is not None:
        rows &= np.isin(recording.trial, list(trials))
    if not (rows & (recording.load_segment > 0)).any():
        raise RecordingError(
            f"{recording.name}: no load at a contact point of the arm file follows unloaded rows "
            "at its command, so there is no tare to estimate from; record load cycles "
            "(cablesense gap protocol)"
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
    """Tension differences (R, M) from tares (R, M), without the part of the arm's history.

    NaN where there is no tare. Also the part (R, 2) of the load that may be hidden, N, along it
    and across it.
    """
    simulation.forget()
    found, hidden_n = np.full_like(tare_n, np.nan), np.zeros((len(recording), 2))
    for row, (difference_n, command_rad, time_s, new) in enumerate(
        _rows_with_tares(recording, tare_n)
    ):
        if new:
            simulation.unloaded(time_s, command_rad)
        if difference_n is not None:
            found[row] = simulation.without_n(difference_n, time_s, command_rad)
            hidden_n[row] = simulation.hidden_n
    return found, hidden_n


def _along(recording: Recording, tare_n: Array, estimator: SequenceEstimator) -> ContactAnswer:
    """Answers on all rows (R,) in their order, with the tares (R, M)."""
    zero, still = np.zeros(tare_n.shape[1]), np.zeros(recording.command_rad.shape[1])
    estimator.forget()
    found = []
    for difference_n, command_rad, time_s, new in _rows_with_tares(recording, tare_n):
        if new:
            estimator.tare()
        read_n = zero if difference_n is None else difference_n
        found.append(estimator.estimate(read_n, command_rad, still, still, time_s))
    return ContactAnswer(
        *(np.array([getattr(each, part.name) for each in found]) for part in fields(ContactAnswer))
    )
