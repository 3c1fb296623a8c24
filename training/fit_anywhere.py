"""Calibration of the statics of contacts anywhere, at the level of torques.

The known contacts explain a part of the torques that tensions show. The residual is noise of the
stated precision, if that is right. The stated deviations are widened where the residual is larger.
"""

from __future__ import annotations

import time

import torch
from scipy.stats import chi2
from torch import Tensor

from cablesense_training.data.dataset import Dataset
from cablesense_training.errors import TrainingError
from cablesense_training.fit import FitHistory, outputs_of, require_fitting, torch_threads
from cablesense_training.networks.closed_form import Balance
from cablesense_training.networks.statics import AnywhereStatics

_CALIBRATED_AT = 0.95
"""The share of samples whose misfit is made that of noise."""
_LEAST_DETERMINED = 0.1
"""Share of the median of the taut cables' least squared lever; below it, the pose shows what no
cable measures."""


def fit_anywhere(network: AnywhereStatics, dataset: Dataset, threads: int = 2) -> FitHistory:
    """Widen in place what a network states, until it holds on the samples of a dataset.

    Raises:
        TrainingError: the dataset does not fit the network, or too few of its samples count.
    """
    start = time.perf_counter()
    with torch_threads(threads):
        found = torch.quantile(misfits(network, dataset), _CALIBRATED_AT)
    expected = chi2.ppf(_CALIBRATED_AT, 2 * network.segment_count)
    # strong contacts leave slack cables, whose misfit is less than noise; weak ones do not
    network.spread.factor *= torch.sqrt(found / expected).clamp(min=1.0)
    return FitHistory((), 0, time.perf_counter() - start)


def misfits(network: AnywhereStatics, dataset: Dataset) -> Tensor:
    """chi² of the torques that the known contacts leave, with 2N degrees of freedom.

    Left out are samples whose pose the taut cables do not determine, and those where a cable
    counts as slack and is not, or the reverse: what statics says there is no matter of noise.

    Raises:
        TrainingError: as `fit_anywhere`.
    """
    require_fitting(network, dataset)
    balance = Balance._make(outputs_of(network, dataset.tension_difference_n, dataset.command_rad))
    known = dataset.local_forces_n, dataset.places_m, dataset.slack_cables
    force, place, slack = map(torch.as_tensor, known)
    lever = balance.by_force_m + place[..., None, None] * balance.by_place
    torque = balance.torque_n_m - (lever * force[..., None]).sum((1, 2))
    chi_square = torch.einsum("bi,bij,bj->b", torque, balance.precision, torque)
    least_lever = 1.0 / torch.linalg.eigvalsh(balance.precision)[:, -1]
    determined = least_lever > _LEAST_DETERMINED * least_lever.median()
    left = chi_square[determined & (balance.taut.sum(1) == network.cable_count - slack)]
    if len(left) < 10:
        raise TrainingError(
            f"the taut cables of {len(left)} of {len(dataset)} samples show torques, which "
            "are too few to train on; give more samples, or weaker contacts"
        )
    return left
