"""Metrics: contacts recognised, errors of direction and magnitude, coverage of the intervals."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base.arrays import Array
from cablesense_training.data.dataset import Dataset
from cablesense_training.inference.estimator import Estimates

Integers = NDArray[np.int64]

FORCE_EDGES_N = (0.0, 2.0, 10.0, 50.0, 100.0, 200.0)
"""Edges of the force bins; the last bin takes its upper edge and everything beyond."""

NORMAL_95 = 1.959964
"""Standard deviations on either side of the mean that hold 95 % of a Gaussian."""


@dataclass(frozen=True, eq=False)
class ContactTruth:
    """True contacts of B samples: segment (B,), 0 for none; angle (B,) and magnitude (B,)."""

    segment: Integers
    angle_deg: Array
    magnitude_n: Array

    @classmethod
    def of(cls, dataset: Dataset) -> ContactTruth:
        """The labels of a single-contact dataset."""
        return cls(dataset.segment, dataset.angle_deg, dataset.magnitude_n)


@dataclass(frozen=True, eq=False)
class ContactAnswer:
    """Answered contacts of B samples, with the stated standard deviations."""

    segment: Integers
    angle_deg: Array
    magnitude_n: Array
    magnitude_std_n: Array
    angle_std_deg: Array

    @classmethod
    def of(cls, estimates: Estimates) -> ContactAnswer:
        """Of an estimator's answers with any leading axes."""
        return cls(*(getattr(estimates, part.name).ravel() for part in fields(cls)))


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
        samples: number of samples.
        contact_accuracy: share of all samples with the right class, no contact being one.
        macro_f1: equation (14) over the classes.
        confusion: rows are true classes (none, segment 1 … N), columns answered ones.
        errors: over all samples with a contact.
        bins: the same by force.
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


def angle_difference_deg(angle_deg: ArrayLike, true_deg: ArrayLike) -> Array:
    """Signed difference of two angles, in [-180, 180)."""
    return (np.asarray(angle_deg, dtype=float) - np.asarray(true_deg) + 180.0) % 360.0 - 180.0


def confusion_matrix(true: ArrayLike, answered: ArrayLike, classes: int) -> Integers:
    """Counts (classes, classes): rows are true classes 0 … classes - 1, columns answered ones."""
    pairs = np.asarray(true, dtype=np.int64) * classes + np.asarray(answered, dtype=np.int64)
    return np.bincount(pairs, minlength=classes * classes).reshape(classes, classes)


def macro_f1(true: ArrayLike, answered: ArrayLike, classes: int) -> float:
    """Equation (14): mean over the classes of 2 precision recall / (precision + recall).

    A class that is neither true nor answered anywhere says nothing and is left out; one that is
    missed or invented altogether counts 0.
    """
    counts = confusion_matrix(true, answered, classes)
    hits = counts.diagonal()
    return _mean_f1(hits, counts.sum(axis=0) - hits, counts.sum(axis=1) - hits)


def single_contact_metrics(
    truth: ContactTruth, answer: ContactAnswer, segment_count: int
) -> SingleContactMetrics:
    """Compare answers with the truth, row by row."""
    classes = segment_count + 1
    confusion = confusion_matrix(truth.segment, answer.segment, classes)
    touched = truth.segment > 0
    place = np.searchsorted(FORCE_EDGES_N, truth.magnitude_n, side="right") - 1
    place = np.minimum(place, len(FORCE_EDGES_N) - 2)
    return SingleContactMetrics(
        samples=len(truth.segment),
        contact_accuracy=_mean(truth.segment == answer.segment),
        macro_f1=macro_f1(truth.segment, answer.segment, classes),
        confusion=tuple(tuple(int(count) for count in row) for row in confusion),
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
        recognition_accuracy=_mean(right[counted]),
        all_segments_right=_mean((right | ~counted).all(axis=1)),
        macro_f1=_mean_f1(*((part & counted).sum(axis=0) for part in outcomes)),
        magnitude_mae_n=tuple(
            _mean(error[(true & counted)[:, n], n]) for n in range(true.shape[1])
        ),
    )


def _errors(truth: ContactTruth, answer: ContactAnswer, chosen: NDArray[np.bool_]) -> ErrorMetrics:
    found = chosen & (answer.segment > 0)
    magnitude = np.where(answer.segment > 0, answer.magnitude_n, 0.0)
    magnitude_error = np.abs(magnitude - truth.magnitude_n)
    angle_error = np.abs(angle_difference_deg(answer.angle_deg, truth.angle_deg))
    return ErrorMetrics(
        contacts=int(chosen.sum()),
        found=int(found.sum()),
        contact_accuracy=_mean((truth.segment == answer.segment)[chosen]),
        direction_mae_deg=_mean(angle_error[found]),
        magnitude_mae_n=_mean(magnitude_error[chosen]),
        magnitude_rmse_n=float(np.sqrt(_mean(magnitude_error[chosen] ** 2))),
        magnitude_coverage95=_mean((magnitude_error <= NORMAL_95 * answer.magnitude_std_n)[found]),
        direction_coverage95=_mean((angle_error <= NORMAL_95 * answer.angle_std_deg)[found]),
    )


def _mean_f1(hits: Integers, invented: Integers, missed: Integers) -> float:
    """Mean F1 of the classes that occur; NaN where none does."""
    scores = []
    for hit, extra, lost in zip(hits.tolist(), invented.tolist(), missed.tolist(), strict=True):
        if hit:
            precision, recall = hit / (hit + extra), hit / (hit + lost)
            scores.append(2.0 * precision * recall / (precision + recall))
        elif extra or lost:
            scores.append(0.0)
    return float(np.mean(scores)) if scores else float("nan")


def _mean(values: NDArray[np.bool_] | Array) -> float:
    return float(np.mean(values)) if values.size else float("nan")
