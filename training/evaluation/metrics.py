"""Metrics of answers: contacts recognised, errors of direction and magnitude, coverage.

For single contacts, for several at once, and for sequences in motion and at rest.
"""

from __future__ import annotations

import itertools
import json
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import TypeAdapter

from cablesense_base import Array
from cablesense_training.data.sequences import Sequences
from cablesense_training.inference.estimator import NORMAL_95

Integers = NDArray[np.int64]

FORCE_EDGES_N = (0.0, 2.0, 10.0, 50.0, 100.0, 200.0)
"""Edges of the force bins; the last bin takes its upper edge and everything beyond."""


@dataclass(frozen=True, eq=False)
class ContactTruth:
    """True contacts of B samples: segment (B,), 0 for none; angle (B,) and magnitude (B,)."""

    segment: Integers
    angle_deg: Array
    magnitude_n: Array

    @classmethod
    def of(cls, answered: Any) -> Self:
        """The labels of a single-contact dataset or of sequences, all axes as one."""
        return cls(*(getattr(answered, part.name).ravel() for part in fields(cls)))

    def select(self, rows: NDArray[np.bool_]) -> Self:
        """Some of the samples."""
        return type(self)(*(column[rows] for column in vars(self).values()))

    @property
    def force_n(self) -> Array:
        """(B,) magnitude where a segment is touched, else 0."""
        return np.where(self.segment > 0, self.magnitude_n, 0.0)


@dataclass(frozen=True, eq=False)
class ContactAnswer(ContactTruth):
    """Answered contacts of B samples, with the stated standard deviations."""

    magnitude_std_n: Array
    angle_std_deg: Array


@dataclass(frozen=True)
class ErrorMetrics:
    """Errors over a set of samples with a contact; NaN where there is nothing to average.

    Attributes:
        contacts: number of samples with a true contact.
        found: number of those that were answered with a contact on any segment.
        contact_accuracy: share of the contacts answered with the right segment.
        direction_mae_deg: mean absolute angle error over the `found`.
        magnitude_mae_n, magnitude_rmse_n: over all `contacts`; an answer of no contact counts as
            0 N.
        magnitude_coverage95, direction_coverage95: share of the `found` within 1.96 stated
            standard deviations.
    """

    contacts: int
    found: int
    contact_accuracy: float
    direction_mae_deg: float
    magnitude_mae_n: float
    magnitude_rmse_n: float
    magnitude_coverage95: float
    direction_coverage95: float


@dataclass(frozen=True)
class ForceBin:
    """Errors over the contacts with a true magnitude from `low_n` up to `high_n`."""

    low_n: float
    high_n: float
    errors: ErrorMetrics


@dataclass(frozen=True)
class SingleContactMetrics:
    """Metrics over a test set, contact-free samples included.

    Attributes:
        contact_accuracy: share of all samples with the right class, no contact being one.
        macro_f1: equation (14) over the classes.
        confusion: rows are true classes (none, segment 1 … N), columns answered ones.
        errors, bins: over all samples with a contact, and by force.
    """

    samples: int
    contact_accuracy: float
    macro_f1: float
    confusion: tuple[tuple[int, ...], ...]
    errors: ErrorMetrics
    bins: tuple[ForceBin, ...]

    @property
    def coverage95(self) -> float:
        """Share of the stated 95 % intervals, of magnitude and direction, that hold the truth."""
        return 0.5 * (self.errors.magnitude_coverage95 + self.errors.direction_coverage95)


@dataclass(frozen=True)
class MultiContactMetrics:
    """Metrics over samples with any number of contacts.

    Attributes:
        judged: number of (sample, segment) pairs that were counted.
        recognition_accuracy: share of those whose touched-or-not is right.
        all_segments_right: share of samples in which every counted segment is right.
        macro_f1: equation (14), over the segments.
        magnitude_mae_n: per segment, over its true contacts; 0 N where it was not recognised.
    """

    judged: int
    recognition_accuracy: float
    all_segments_right: float
    macro_f1: float
    magnitude_mae_n: tuple[float, ...]


def plain_values(metrics: Any) -> Any:
    """Metrics as JSON has them; NaN, where there was nothing to average, as None."""
    return json.loads(TypeAdapter(Any).dump_json(metrics))


def angle_difference_deg(angle_deg: ArrayLike, true_deg: ArrayLike) -> Array:
    """Signed difference of two angles, in [-180, 180)."""
    return (np.asarray(angle_deg, dtype=float) - np.asarray(true_deg) + 180.0) % 360.0 - 180.0


def confusion_matrix(true: ArrayLike, answered: ArrayLike, classes: int) -> Integers:
    """Counts (classes, classes): rows are true classes 0 … classes - 1, columns answered ones."""
    pairs = np.asarray(true, dtype=np.int64) * classes + np.asarray(answered, dtype=np.int64)
    return np.bincount(pairs, minlength=classes * classes).reshape(classes, classes)


def macro_f1(confusion: Integers) -> float:
    """Equation (14): mean over the classes of 2 precision recall / (precision + recall).

    A class that is neither true nor answered anywhere says nothing and is left out; one that is
    missed or invented altogether counts 0.
    """
    hits = confusion.diagonal()
    return _mean_f1(hits, confusion.sum(axis=0) - hits, confusion.sum(axis=1) - hits)


def single_contact_metrics(
    truth: ContactTruth, answer: ContactAnswer, segment_count: int
) -> SingleContactMetrics:
    """Compare answers with the truth, row by row."""
    confusion = confusion_matrix(truth.segment, answer.segment, segment_count + 1)
    touched = truth.segment > 0
    place = np.searchsorted(FORCE_EDGES_N, truth.magnitude_n, side="right") - 1
    place = np.minimum(place, len(FORCE_EDGES_N) - 2)
    return SingleContactMetrics(
        samples=len(truth.segment),
        contact_accuracy=mean_or_nan(truth.segment == answer.segment),
        macro_f1=macro_f1(confusion),
        confusion=tuple(tuple(row) for row in confusion.tolist()),
        errors=_errors(truth, answer, touched),
        bins=tuple(
            ForceBin(low, high, _errors(truth, answer, touched & (place == i)))
            for i, (low, high) in enumerate(itertools.pairwise(FORCE_EDGES_N))
        ),
    )


def multi_contact_metrics(
    touched: ArrayLike,
    magnitude_n: ArrayLike,
    answered: ArrayLike,
    answered_magnitude_n: ArrayLike,
    smallest_force_n: float = 0.0,
) -> MultiContactMetrics:
    """Compare contacts (B, N) and magnitudes (B, N) with the truth.

    Touched segments whose true magnitude is below `smallest_force_n` are left out; untouched ones
    always count.
    """
    true, found = np.asarray(touched, dtype=bool), np.asarray(answered, dtype=bool)
    force = np.where(true, np.asarray(magnitude_n, dtype=float), 0.0)
    estimate = np.where(found, np.asarray(answered_magnitude_n, dtype=float), 0.0)
    counted = ~true | (force >= smallest_force_n)
    right = true == found
    outcomes = (true & found, ~true & found, true & ~found)
    error = np.abs(estimate - force)
    return MultiContactMetrics(
        judged=int(counted.sum()),
        recognition_accuracy=mean_or_nan(right[counted]),
        all_segments_right=mean_or_nan((right | ~counted).all(axis=1)),
        macro_f1=_mean_f1(*((part & counted).sum(axis=0) for part in outcomes)),
        magnitude_mae_n=tuple(
            mean_or_nan(error[(true & counted)[:, n], n]) for n in range(true.shape[1])
        ),
    )


SETTLED_S = 0.5
"""After so long without motion an arm counts as at rest, as the estimator node waits."""


@dataclass(frozen=True)
class SequenceMetrics:
    """Metrics over sequences.

    Attributes:
        every, moving, rest: over all ticks, those in motion or just after it, and the others.
        false_force_n, false_force_moving_n, false_force_rest_n: mean force answered where nothing
            touches.
    """

    every: SingleContactMetrics
    moving: SingleContactMetrics
    rest: SingleContactMetrics
    false_force_n: float
    false_force_moving_n: float
    false_force_rest_n: float


def sequence_metrics(answer: ContactAnswer, sequences: Sequences) -> SequenceMetrics:
    """The metrics of answers (S · T,), in motion and at rest."""
    truth, moving = ContactTruth.of(sequences), unsettled(sequences).ravel()
    segments = sequences.arm.segment_count
    metrics, false_force_n = [], []
    for rows in (np.ones_like(moving), moving, ~moving):
        metrics.append(single_contact_metrics(truth.select(rows), answer.select(rows), segments))
        force = answer.force_n[rows & (truth.segment == 0)]
        false_force_n.append(mean_or_nan(force) if force.size else 0.0)
    every, in_motion, at_rest = metrics
    return SequenceMetrics(every, in_motion, at_rest, *false_force_n)


def unsettled(sequences: Sequences) -> NDArray[np.bool_]:
    """(S, T) whether the set-point moves, or did within the last `SETTLED_S`."""
    moving = (sequences.joint_speed_rad_s != 0.0).any(axis=-1)
    ticks = max(1, round(SETTLED_S / sequences.protocol.tick_s))
    padded = np.pad(moving, ((0, 0), (ticks - 1, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, ticks, axis=1)
    return np.asarray(windows.any(axis=-1))


def _errors(truth: ContactTruth, answer: ContactAnswer, chosen: NDArray[np.bool_]) -> ErrorMetrics:
    found = chosen & (answer.segment > 0)
    magnitude_error = np.abs(answer.force_n - truth.magnitude_n)
    angle_error = np.abs(angle_difference_deg(answer.angle_deg, truth.angle_deg))
    return ErrorMetrics(
        contacts=int(chosen.sum()),
        found=int(found.sum()),
        contact_accuracy=mean_or_nan((truth.segment == answer.segment)[chosen]),
        direction_mae_deg=mean_or_nan(angle_error[found]),
        magnitude_mae_n=mean_or_nan(magnitude_error[chosen]),
        magnitude_rmse_n=float(np.sqrt(mean_or_nan(magnitude_error[chosen] ** 2))),
        magnitude_coverage95=mean_or_nan(
            (magnitude_error <= NORMAL_95 * answer.magnitude_std_n)[found]
        ),
        direction_coverage95=mean_or_nan((angle_error <= NORMAL_95 * answer.angle_std_deg)[found]),
    )


def _mean_f1(hits: Integers, invented: Integers, missed: Integers) -> float:
    """Mean F1 of the classes that occur; NaN where none does."""
    with np.errstate(invalid="ignore"):
        precision, recall = hits / (hits + invented), hits / (hits + missed)
        scores = 2.0 * precision * recall / (precision + recall)
    return mean_or_nan(np.where(hits > 0, scores, 0.0)[hits + invented + missed > 0])


def mean_or_nan(values: NDArray[np.bool_] | Array) -> float:
    """Mean; NaN of nothing."""
    return float(np.mean(values)) if values.size else float("nan")
