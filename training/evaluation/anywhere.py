"""Errors of contacts anywhere, segment by segment, their Cramér-Rao bounds, and baselines.

The bound is of all components of the force and the place at once, with the posterior's priors of
the axial force and of the place: without them a straight arm determines no axial force, and
segment 1 no place. Errors over the bound are one where an estimate is efficient.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.build import mechanism_of
from cablesense_sim.contact_location import (
    AXIAL_STD_N,
    ContactPair,
    Location,
    TorqueBalance,
    locate,
    locate_two,
)
from cablesense_training.data.dataset import Dataset
from cablesense_training.evaluation.metrics import (
    mean_or_nan,
    plain_values,
    reading_variance_n2,
    tension_gain,
)
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import Estimator

CLEAR_STD = 3.0
"""Deviations of the place from the ends of its segment beyond which the segment must be right."""

DETERMINED_M = 0.005
"""Two contacts are judged where the bounds of both places are below this."""

_HALF_NORMAL_MEDIAN = 0.6744898
"""Median of the absolute value of a standard normal number."""

_PROFILE_PLACES = 116
"""Places on each segment: 1 mm on the bundled arms."""
_FALSE_CONTACTS = 1e-5
"""Share of untouched samples that may be answered with a contact."""


class LocatedContacts(NamedTuple):
    """Answers on B samples as `Location` has them, with 95 % intervals if there are any.

    `moment_n_m` is (B,) about the joint centre.
    """

    segment: NDArray[np.int64]
    place_m: Array
    force_n: Array
    moment_n_m: Array
    place_ci95_m: Array | None = None
    magnitude_ci95_n: Array | None = None

    @classmethod
    def of(cls, found: Location) -> Self:
        """The posterior's."""
        moment = np.linalg.norm(found.moment_n_m, axis=1)
        intervals = found.place_ci95_m, found.magnitude_ci95_n
        return cls(found.segment, found.place_m, found.force_n, moment, *intervals)

    def select(self, rows: NDArray[np.bool_]) -> Self:
        """Some of the samples."""
        return self._replace(
            **{name: part[rows] for name, part in self._asdict().items() if part is not None}
        )


@dataclass(frozen=True)
class BoundedErrors:
    """Absolute errors of one number over a set of contacts, in its unit; NaN of none.

    Those over the bound are one where errors are normal with their standard deviations at best.
    """

    median: float
    rms: float
    quantile95: float
    rms_over_bound: float
    median_over_bound: float

    @classmethod
    def of(cls, error: Array, bound_std: Array) -> Self:
        """Of errors (C,) with their bounds (C,); a bound of zero is unknown and does not count."""
        error, bound_std = error[bound_std > 0.0], bound_std[bound_std > 0.0]
        if not len(error):
            return cls(*[float("nan")] * 5)
        size, ratio = np.abs(error), np.abs(error) / bound_std
        return cls(
            float(np.median(size)),
            float(np.sqrt((size**2).mean())),
            float(np.quantile(size, 0.95)),
            float(np.sqrt((ratio**2).mean())),
            float(np.median(ratio)) / _HALF_NORMAL_MEDIAN,
        )


@dataclass(frozen=True)
class SegmentErrors:
    """Single contacts on one segment; errors and coverage where the segment is right.

    Attributes:
        contacts: their number.
        segment_right: share of them.
        clear_segment_right: share of those whose place is `CLEAR_STD` deviations from the ends.
        normal_n, axial_n: of the force's magnitude normal to the segment, and along it.
        place_coverage95, normal_coverage95: share of the intervals that hold the truth, or NaN.
    """

    contacts: int
    segment_right: float
    clear_segment_right: float
    place_mm: BoundedErrors
    normal_n: BoundedErrors
    axial_n: BoundedErrors
    moment_n_m: BoundedErrors
    place_coverage95: float
    normal_coverage95: float


@dataclass(frozen=True)
class PairErrors:
    """Two contacts at once, where the tensions determine both places.

    Attributes:
        samples: with two contacts.
        determined: share in which the bounds of both places are below `DETERMINED_M`.
        segments_right: share of these with both segments right.
        place_mm, normal_n: of all their contacts, where the segments are right.
    """

    samples: int
    determined: float
    segments_right: float
    place_mm: BoundedErrors
    normal_n: BoundedErrors


@dataclass(frozen=True)
class AnywhereMetrics:
    """Metrics over a dataset of protocol `anywhere`.

    Attributes:
        untouched, false_contacts: samples without a contact, and those answered with one.
        segments: by segment, from 1 on.
        pairs: two contacts at once; None where the answers are of one.
    """

    untouched: int
    false_contacts: int
    segments: tuple[SegmentErrors, ...]
    pairs: PairErrors | None = None

    def as_json(self) -> dict[str, Any]:
        """As plain values: shares, then each kind of errors; None for what there is nothing of."""
        plain = asdict(self)
        rows = {f"segment_{n}": each for n, each in enumerate(plain.pop("segments"), start=1)}
        if (pairs := plain.pop("pairs")) is not None:
            rows["pairs"] = pairs
        kinds = [part.name for part in fields(SegmentErrors) if part.type == "BoundedErrors"]
        errors = {
            kind: {name: row.pop(kind) for name, row in rows.items() if kind in row}
            for kind in kinds
        }
        return dict(plain_values({**plain, "shares": rows, **errors}))


def bound_covariance(dataset: Dataset, count: int) -> Array:
    """(B, 4K, 4K) bound on the covariance of (f_x, f_y, f_z, place) of `count` = K contacts each.

    Forces are along the axes of the segments at the command.

    Raises:
        EquilibriumError: the arm has no rest under one of the samples' contacts.
    """
    segments, places_m, forces_n = touched(dataset, count)
    seen = tension_gain(dataset, segments, places_m, forces_n)
    information = np.swapaxes(seen, 1, 2) @ seen / reading_variance_n2(dataset)
    near, far = dataset.protocol.reach_m(dataset.arm).T
    prior = np.zeros((len(dataset), count, 4))
    prior[..., 0] = AXIAL_STD_N**-2
    prior[..., 3] = (12.0 / (far - near) ** 2)[segments - 1]
    own = np.arange(4 * count)
    information[:, own, own] += prior.reshape(len(dataset), -1)
    # the inverse, but for the few samples without a rest: `tension_gain` knows nothing of these
    return np.asarray(np.linalg.pinv(information, hermitian=True))


def touched(dataset: Dataset, count: int) -> tuple[NDArray[np.int64], Array, Array]:
    """Segments (B, K) from 1 on, ascending, places (B, K) and forces (B, K, 3) of K contacts."""
    segments = np.nonzero(dataset.contacts)[1].reshape(len(dataset), count)
    places_m = np.take_along_axis(dataset.places_m, segments, axis=1)
    forces_n = np.take_along_axis(dataset.local_forces_n, segments[..., None], axis=1)
    return segments + 1, places_m, forces_n


def anywhere_metrics(
    dataset: Dataset, answer: LocatedContacts, pairs: ContactPair | None = None
) -> AnywhereMetrics:
    """The metrics of answers on every sample, and of pairs on those with two contacts."""
    number = dataset.contacts.sum(axis=1)
    single, two = dataset.select(number == 1), dataset.select(number == 2)
    found = answer.segment[number == 0] > 0
    return AnywhereMetrics(
        untouched=len(found),
        false_contacts=int(found.sum()),
        segments=_by_segment(single, answer.select(number == 1)),
        pairs=None if pairs is None or not len(two) else _of_pairs(two, pairs),
    )


def evaluate_anywhere(estimator: AnywhereEstimator, dataset: Dataset) -> AnywhereMetrics:
    """The metrics of a model on a dataset of its arm."""
    balance, _ = estimator.balance_batch(dataset.tension_difference_n, dataset.command_rad)
    found = locate(balance, estimator.reach_m, estimator.surface)
    two = dataset.contacts.sum(axis=1) == 2
    of_two = TorqueBalance(*(part[two] for part in balance))
    pairs = locate_two(of_two, estimator.reach_m, surface=estimator.surface)
    return anywhere_metrics(dataset, LocatedContacts.of(found), pairs)


def _by_segment(single: Dataset, answer: LocatedContacts) -> tuple[SegmentErrors, ...]:
    numbers, places, forces = touched(single, 1)
    segments, places_m, forces_n = numbers[:, 0], places[:, 0], forces[:, 0]
    covariance = bound_covariance(single, 1)
    normal_n = np.linalg.norm(forces_n[:, 1:], axis=1)
    # derivatives of the normal force and of its moment by (f_x, f_y, f_z, place)
    of_normal = np.zeros((len(single), 4))
    of_normal[:, 1:3] = forces_n[:, 1:] / normal_n[:, None]
    of_moment = of_normal * places_m[:, None]
    of_moment[:, 3] = normal_n
    along_std_n, place_std_m = (np.sqrt(covariance[:, k, k]) for k in (0, 3))
    normal_std_n, moment_std = (
        np.sqrt(np.einsum("bi,bij,bj->b", by, covariance, by)) for by in (of_normal, of_moment)
    )
    near, far = single.protocol.reach_m(single.arm)[segments - 1].T
    clear = np.minimum(places_m - near, far - places_m) > CLEAR_STD * place_std_m
    right = answer.segment == segments
    found_n = np.linalg.norm(answer.force_n[:, 1:], axis=1)

    def held(value: Array, interval: Array | None, rows: NDArray[np.bool_]) -> float:
        if interval is None:
            return float("nan")
        return mean_or_nan(((value >= interval[:, 0]) & (value <= interval[:, 1]))[rows])

    metrics = []
    for n in range(1, single.arm.segment_count + 1):
        own = segments == n
        at = own & right

        def errors(
            found: Array, true: Array, std: Array, at: NDArray[np.bool_] = at
        ) -> BoundedErrors:
            return BoundedErrors.of((found - true)[at], std[at])

        metrics.append(
            SegmentErrors(
                contacts=int(own.sum()),
                segment_right=mean_or_nan(right[own]),
                clear_segment_right=mean_or_nan(right[own & clear]),
                place_mm=errors(1e3 * answer.place_m, 1e3 * places_m, 1e3 * place_std_m),
                normal_n=errors(found_n, normal_n, normal_std_n),
                axial_n=errors(answer.force_n[:, 0], forces_n[:, 0], along_std_n),
                moment_n_m=errors(answer.moment_n_m, places_m * normal_n, moment_std),
                place_coverage95=held(places_m, answer.place_ci95_m, at),
                normal_coverage95=held(normal_n, answer.magnitude_ci95_n, at),
            )
        )
    return tuple(metrics)


def _of_pairs(two: Dataset, found: ContactPair) -> PairErrors:
    segments, places_m, forces_n = touched(two, 2)
    covariance = bound_covariance(two, 2)
    of_place = np.array([3, 7])
    place_std_m = np.sqrt(covariance[:, of_place, of_place])
    determined = np.asarray((place_std_m < DETERMINED_M).all(axis=1))
    right = np.asarray(determined & (found.segments == segments).all(axis=1))
    normal_n, found_n = (np.linalg.norm(f[..., 1:], axis=-1) for f in (forces_n, found.force_n))
    by = forces_n[..., 1:] / normal_n[..., None]
    blocks = np.stack([covariance[:, 1:3, 1:3], covariance[:, 5:7, 5:7]], axis=1)
    normal_std_n = np.sqrt(np.einsum("bki,bkij,bkj->bk", by, blocks, by))
    off_mm = 1e3 * (found.place_m - places_m)[right].ravel()
    return PairErrors(
        samples=len(two),
        determined=mean_or_nan(determined),
        segments_right=mean_or_nan(right[determined]),
        place_mm=BoundedErrors.of(off_mm, 1e3 * place_std_m[right].ravel()),
        normal_n=BoundedErrors.of(
            (found_n - normal_n)[right].ravel(), normal_std_n[right].ravel()
        ),
    )


def commanded_profile(dataset: Dataset) -> LocatedContacts:
    """The force that fits best at every place, as if the arm stood where it is commanded.

    The contact is the place of least misfit on all segments, unless noise explains the tensions.
    There are no intervals, no slack cables and no deflection.
    """
    mechanism, command = mechanism_of(dataset.arm), dataset.command_rad
    axes = kinematics.segment_rotations(mechanism, command)
    jacobian = kinematics.cable_jacobian_m(mechanism, command)
    torque = np.einsum("bmj,bm->bj", jacobian, dataset.tension_difference_n)
    reading_n2 = reading_variance_n2(dataset)
    precision = np.linalg.inv(reading_n2 * np.swapaxes(jacobian, 1, 2) @ jacobian)
    untouched = np.einsum("bi,bij,bj->b", torque, precision, torque)
    at_joint, by_place = kinematics.contact_torques(mechanism, command, axes)
    most = np.full(len(dataset), -np.inf)
    segment, place_m = np.zeros(len(dataset), dtype=np.int64), np.zeros(len(dataset))
    force_n = np.zeros((len(dataset), 3))
    for n, (low, high) in enumerate(dataset.protocol.reach_m(dataset.arm)):
        for at_m in np.linspace(low, high, _PROFILE_PLACES):
            lever = at_joint[:, n] + at_m * by_place[:, n]
            weighted = lever @ precision
            information = weighted @ np.swapaxes(lever, 1, 2)
            information[:, 0, 0] += AXIAL_STD_N**-2
            pull = weighted @ torque[..., None]
            force = np.linalg.solve(information, pull)[..., 0]
            gain = np.einsum("bi,bi->b", force, pull[..., 0])
            better = gain > most
            most[better], segment[better], place_m[better] = gain[better], n + 1, at_m
            force_n[better] = force[better]
    segment[untouched < chi2.isf(_FALSE_CONTACTS, torque.shape[1])] = 0
    return _at(segment, place_m, force_n)


def four_points(estimator: Estimator, dataset: Dataset) -> LocatedContacts:
    """A model of contacts at the points of the arm file, which knows no axial force."""
    found = estimator.estimate_batch(dataset.tension_difference_n, dataset.command_rad)
    theta, size = np.deg2rad(found.angle_deg), found.magnitude_n
    force_n = np.stack([0.0 * size, size * np.sin(theta), size * np.cos(theta)], axis=1)
    points_m = np.concatenate([[0.0], mechanism_of(dataset.arm).contact_m])
    return _at(found.segment, points_m[found.segment], force_n)


def _at(segment: NDArray[np.int64], place_m: Array, force_n: Array) -> LocatedContacts:
    moment = place_m * np.linalg.norm(force_n[:, 1:], axis=1)
    return LocatedContacts(segment, place_m, force_n, moment)
