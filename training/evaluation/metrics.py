"""Metrics of answers: contacts recognised, errors of direction and magnitude, coverage.

The noise bound says how well any unbiased estimator could do on the very same samples: no estimate
of forces f has a covariance below C = v (G' G)^-1, with v the variance of a tension difference and
G = d dT / d f (docs/physics.md; Kay, Fundamentals of Statistical Signal Processing, vol. I, 1993,
section 3.8). Angle and magnitude follow by drawing from N(f, C): the error of a weak force's angle
is not Gaussian.
"""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import TypeAdapter

from cablesense_base import Array
from cablesense_contact.estimate import NORMAL_95
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.noise_bound import contact_response
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import solved_rows

Integers = NDArray[np.int64]

FORCE_EDGES_N = (0.0, 2.0, 10.0, 50.0, 100.0, 200.0)
"""Edges of the force bins; the last bin takes its upper edge and everything beyond."""

_DRAWS = 64
"""Of each force, for the noise bound."""

_MOST_WITHOUT_REST = 0.001
"""Share of samples that may find no rest when they are solved again: the rounding of a force that
was turned between frames decides it where an arm is about to turn."""


@dataclass(frozen=True, eq=False)
class ContactTruth:
    """True contacts of B samples: segment (B,), 0 for none; angle (B,) and magnitude (B,)."""

    segment: Integers
    angle_deg: Array
    magnitude_n: Array

    @classmethod
    def of(cls, answered: Any) -> Self:
        """The labels of a single-contact dataset, or the answers in `Estimates`."""
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
        direction_mae_deg: over the `found`.
        magnitude_mae_n, magnitude_rmse_n: over all `contacts`; no contact counts as 0 N.
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
        magnitude_mae_n: per segment, over its true contacts; unrecognised ones count as 0 N.
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

    A class that is neither true nor answered anywhere is left out; one that is missed or invented
    altogether counts 0.
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
    true = np.asarray(touched, dtype=bool)
    stated = np.asarray(answered, dtype=bool)
    force = np.where(true, np.asarray(magnitude_n, dtype=float), 0.0)
    estimate = np.where(stated, np.asarray(answered_magnitude_n, dtype=float), 0.0)
    counted = ~true | (force >= smallest_force_n)
    right = true == stated
    outcomes = (true & stated, ~true & stated, true & ~stated)
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


def _errors(truth: ContactTruth, answer: ContactAnswer, chosen: NDArray[np.bool_]) -> ErrorMetrics:
    hits = chosen & (answer.segment > 0)
    magnitude_error = np.abs(answer.force_n - truth.magnitude_n)
    angle_error = np.abs(angle_difference_deg(answer.angle_deg, truth.angle_deg))
    return ErrorMetrics(
        contacts=int(chosen.sum()),
        found=int(hits.sum()),
        contact_accuracy=mean_or_nan((truth.segment == answer.segment)[chosen]),
        direction_mae_deg=mean_or_nan(angle_error[hits]),
        magnitude_mae_n=mean_or_nan(magnitude_error[chosen]),
        magnitude_rmse_n=float(np.sqrt(mean_or_nan(magnitude_error[chosen] ** 2))),
        magnitude_coverage95=mean_or_nan(
            (magnitude_error <= NORMAL_95 * answer.magnitude_std_n)[hits]
        ),
        direction_coverage95=mean_or_nan((angle_error <= NORMAL_95 * answer.angle_std_deg)[hits]),
    )


def _mean_f1(hits: Integers, invented: Integers, missed: Integers) -> float:
    """Mean F1 of the classes that occur; NaN where none does."""
    with np.errstate(invalid="ignore"):
        precision = hits / (hits + invented)
        recall = hits / (hits + missed)
        scores = 2.0 * precision * recall / (precision + recall)
    return mean_or_nan(np.where(hits > 0, scores, 0.0)[hits + invented + missed > 0])


def mean_or_nan(values: NDArray[np.bool_] | Array) -> float:
    """Mean; NaN of nothing."""
    return float(np.mean(values)) if values.size else float("nan")


@dataclass(frozen=True)
class NoiseBound:
    """Errors of an efficient unbiased estimator over a number of contacts."""

    contacts: int
    magnitude_mae_n: float
    magnitude_rmse_n: float
    direction_mae_deg: float


def tension_gain(
    dataset: Dataset, segments: NDArray[np.int64], places_m: Array, forces_n: Array
) -> Array:
    """(B, M, 4K) `contact_response` of K contacts each; zero of slack cables.

    It is also zero for the few samples that find no rest here.

    Raises:
        EquilibriumError: the arm has no rest under the contacts of more samples than a thousandth.
    """
    nominal = mechanism_of(dataset.arm)
    mechanism = amended(nominal, entries_of(dataset.arm))
    held_m = held_lengths_m(nominal, dataset.command_rad)
    count, cables = held_m.shape

    def gain_of(rows: NDArray[np.int64]) -> Array:
        elastic_n, gain = contact_response(
            mechanism,
            dataset.command_rad[rows],
            segments[rows],
            places_m[rows],
            forces_n[rows],
            held_m[rows],
        )
        return np.asarray(gain * (elastic_n > 0.0)[..., None]).reshape(len(rows), -1)

    columns = 4 * cables * segments.shape[1]
    allowed = math.ceil(_MOST_WITHOUT_REST * count)
    gain = solved_rows((count, columns), allowed, gain_of)
    return np.nan_to_num(gain).reshape(count, cables, columns // cables)


def force_covariance_n2(dataset: Dataset) -> Array:
    """Bound (B, N, 2, 2) on the covariance of the (y, z) force on each segment that is touched.

    Which segments are touched is known.
    """
    shape = len(dataset), dataset.arm.segment_count
    segments = np.broadcast_to(np.arange(1, shape[1] + 1), shape)
    places_m = np.broadcast_to(dataset.protocol.touched_m(dataset.arm)[:, 0], shape)
    gain = tension_gain(dataset, segments, places_m, dataset.local_forces_n)
    lateral = gain.reshape(*gain.shape[:2], -1, 4)[..., 1:3] * dataset.contacts[:, None, :, None]
    flat = lateral.reshape(*gain.shape[:2], -1)
    variance_n2 = difference_variance_n2(dataset.arm.sensors, dataset.protocol.tare_samples)
    information = np.swapaxes(flat, 1, 2) @ flat / variance_n2
    diagonal = np.arange(flat.shape[2])
    information[:, diagonal, diagonal] += np.repeat(~dataset.contacts, 2, axis=1)
    covariance = np.linalg.pinv(information, hermitian=True).reshape(*shape, 2, shape[1], 2)
    return np.stack([covariance[:, n, :, n] for n in range(shape[1])], axis=1)


def noise_bound(dataset: Dataset) -> NoiseBound:
    """The bound over a single-contact dataset's contacts, without those where none is known."""
    dataset = dataset.select(dataset.segment > 0)
    covariance = force_covariance_n2(dataset)[dataset.contacts]
    known = covariance.any(axis=(1, 2))
    dataset = dataset.select(known)
    covariance = covariance[known]
    magnitude = dataset.magnitude_n
    angle_deg = dataset.angle_deg
    theta = np.deg2rad(angle_deg)
    force = magnitude[:, None] * np.stack([np.sin(theta), np.cos(theta)], axis=-1)
    root = np.linalg.cholesky(covariance)
    normal = np.random.default_rng(0).normal(size=(_DRAWS, len(force), 2, 1))
    drawn = force + (root @ normal)[..., 0]
    magnitude_error = np.hypot(drawn[..., 0], drawn[..., 1]) - magnitude
    drawn_deg = np.rad2deg(np.arctan2(drawn[..., 0], drawn[..., 1]))
    return NoiseBound(
        contacts=len(force),
        magnitude_mae_n=float(np.abs(magnitude_error).mean()),
        magnitude_rmse_n=float(np.sqrt((magnitude_error**2).mean())),
        direction_mae_deg=float(np.abs(angle_difference_deg(drawn_deg, angle_deg)).mean()),
    )


def multi_contact_bound_n(dataset: Dataset, weakest_n: float = 0.0) -> Array:
    """Bound (N,) on the mean absolute force error per segment, over contacts from `weakest_n`.

    A magnitude's error is taken as Gaussian along its force, as it is for forces far above noise.
    """
    theta = np.deg2rad(dataset.angles_deg)
    along = np.stack([np.sin(theta), np.cos(theta)], axis=-1)[..., None]
    variance = (along * (force_covariance_n2(dataset) @ along)).sum((-2, -1))
    known = variance > 0.0  # see `tension_gain`
    counted = dataset.contacts & known & (dataset.magnitudes_n >= weakest_n)
    std_n = np.sqrt(np.where(counted, variance, np.nan))
    return np.asarray(np.sqrt(2.0 / np.pi) * np.nanmean(std_n, axis=0))
