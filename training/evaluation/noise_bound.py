"""The noise bound: how well any unbiased estimator could do on the very same samples (Cramér-Rao).

No unbiased estimate of forces f has a covariance below C = v (G' G)^-1, with v the variance of a
tension difference and G = d dT / d f (docs/physics.md; Kay, Fundamentals of Statistical Signal
Processing, vol. I, 1993, section 3.8). Angle and magnitude follow by drawing from N(f, C): the
error of a weak force's angle is not Gaussian.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.contact_location import contact_response
from cablesense_sim.effects.registry import amended
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.data.dataset import Dataset
from cablesense_training.evaluation.metrics import angle_difference_deg

_DRAWS = 64


@dataclass(frozen=True)
class NoiseBound:
    """Errors of an efficient unbiased estimator over a set of contacts.

    Attributes:
        contacts: number of contacts.
        magnitude_mae_n, magnitude_rmse_n, direction_mae_deg: its errors.
    """

    contacts: int
    magnitude_mae_n: float
    magnitude_rmse_n: float
    direction_mae_deg: float


def tension_gain(
    dataset: Dataset, segments: NDArray[np.int64], places_m: Array, forces_n: Array
) -> Array:
    """(B, M, 4K) tensions by (f_x, f_y, f_z, place) of K contacts, as `contact_response` has them.

    Those of slack cables are zero.

    Raises:
        EquilibriumError: the arm has no rest under one of the samples' contacts.
    """
    nominal = mechanism_of(dataset.arm)
    mechanism = amended(nominal, entries_of(dataset.arm))
    held_m = held_lengths_m(nominal, dataset.command_rad)
    elastic_n, gain = contact_response(
        mechanism, dataset.command_rad, segments, places_m, forces_n, held_m
    )
    return np.asarray(gain * (elastic_n > 0.0)[..., None])


def reading_variance_n2(dataset: Dataset) -> float:
    """Of one tension difference."""
    return difference_variance_n2(dataset.arm.sensors, dataset.protocol.tare_samples)


def force_covariance_n2(dataset: Dataset) -> Array:
    """Bound (B, N, 2, 2) on the covariance of the (y, z) force on each segment that is touched.

    All contacts of a sample are unknown at once, and which segments are touched is known.
    """
    shape = len(dataset), dataset.arm.segment_count
    segments = np.broadcast_to(np.arange(1, shape[1] + 1), shape)
    places_m = np.broadcast_to(dataset.protocol.reach_m(dataset.arm)[:, 0], shape)
    gain = tension_gain(dataset, segments, places_m, dataset.local_forces_n)
    lateral = gain.reshape(*gain.shape[:2], -1, 4)[..., 1:3] * dataset.contacts[:, None, :, None]
    flat = lateral.reshape(*gain.shape[:2], -1)
    information = np.swapaxes(flat, 1, 2) @ flat / reading_variance_n2(dataset)
    own = np.arange(flat.shape[2])
    information[:, own, own] += np.repeat(~dataset.contacts, 2, axis=1)
    covariance = np.linalg.pinv(information, hermitian=True).reshape(*shape, 2, shape[1], 2)
    return np.stack([covariance[:, n, :, n] for n in range(shape[1])], axis=1)


def noise_bound(dataset: Dataset) -> NoiseBound:
    """The bound over a single-contact dataset's contacts."""
    dataset = dataset.select(dataset.segment > 0)
    magnitude, angle_deg = dataset.magnitude_n, dataset.angle_deg
    covariance = force_covariance_n2(dataset)[dataset.contacts]
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
    counted = dataset.contacts & (dataset.magnitudes_n >= weakest_n)
    std_n = np.sqrt(np.where(counted, variance, np.nan))
    return np.asarray(np.sqrt(2.0 / np.pi) * np.nanmean(std_n, axis=0))
