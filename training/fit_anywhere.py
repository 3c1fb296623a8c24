"""Training on contacts anywhere, at the level of torques.

The known contacts explain a part of the torques that tensions show. The residual is noise, if the
network's shift and precision are right: their loss is its negative log-likelihood. Statics has
nothing to learn and is computed once.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from scipy.stats import chi2
from torch import Tensor

from cablesense_training.data.dataset import Dataset
from cablesense_training.errors import TrainingError
from cablesense_training.fit import (
    ROWS_AT_ONCE,
    FitHistory,
    FitSettings,
    LossTerms,
    OnEpoch,
    PlateauObjective,
    joined,
    require_fitting,
    take,
    torch_threads,
)
from cablesense_training.networks.anywhere import AnywhereStatics, ContactBalance

_CALIBRATED_AT = 0.95
"""The share of held-out samples whose misfit is made that of noise."""
_LEAST_DETERMINED = 0.1
"""Where the taut cables' least squared lever is below this share of the median, the pose shows
what no cable measures."""
_SURE = 3.0
"""Standard errors by which the learnt correction must lower the held-out loss."""


class KnownTorques(NamedTuple):
    """B samples: torques by statics, and those that the true contacts make.

    Attributes:
        torque_n_m: (B, 2N) that are left by the contacts.
        precision: (B, 2N, 2N) inverse covariance of them.
        taut: (B, M) one for taut cables, zero for slack ones.
    """

    torque_n_m: Tensor
    precision: Tensor
    taut: Tensor


def known_torques(network: AnywhereStatics, dataset: Dataset) -> KnownTorques:
    """Torques that the known contacts leave, by the statics of a network that has learnt nothing.

    Left out are samples whose pose the taut cables do not determine, and those where a cable
    counts as slack and is not, or the reverse: what statics says there is no matter of noise.

    Raises:
        TrainingError: the dataset does not fit the network, or too few samples are left.
    """
    require_fitting(network, dataset)
    parts = []
    for at in range(0, len(dataset), ROWS_AT_ONCE):
        rows = dataset.select(slice(at, at + ROWS_AT_ONCE))
        given = rows.tension_difference_n, rows.command_rad, rows.local_forces_n, rows.places_m
        difference, command, force, place = map(torch.as_tensor, given)
        with torch.no_grad():
            balance = network.untaught(difference, command)
        torque = balance.torque_n_m - torques_by_contacts(balance, force, place)
        parts.append(KnownTorques(torque, balance.precision, balance.taut))
    every = joined(parts)
    slack = torch.as_tensor(dataset.slack_cables)
    least_lever = 1.0 / torch.linalg.eigvalsh(every.precision)[:, -1]
    determined = least_lever > _LEAST_DETERMINED * least_lever.median()
    left = take(every, determined & (every.taut.sum(1) == network.cable_count - slack))
    if len(left.taut) < 10:
        raise TrainingError(
            f"the taut cables of {len(left.taut)} of {len(dataset)} samples show torques, which "
            "are too few to train on; give more samples, or weaker contacts"
        )
    return left


def torques_by_contacts(balance: ContactBalance, force_n: Tensor, place_m: Tensor) -> Tensor:
    """Torques (B, 2N) of contacts: forces (B, N, 3) in the segments' axes, places (B, N)."""
    lever = balance.by_force_m + place_m[..., None, None] * balance.by_place
    return (lever * force_n[..., None]).sum((1, 2))


def fit_anywhere(
    network: AnywhereStatics,
    dataset: Dataset,
    settings: FitSettings | None = None,
    on_epoch: OnEpoch | None = None,
) -> FitHistory:
    """Train a network in place as `fit.fit` does, and calibrate its precision on held-out samples.

    Raises:
        TrainingError: as `fit.fit`.
    """
    settings = settings or FitSettings()
    with torch_threads(settings.threads):
        return _TorqueObjective(network, known_torques(network, dataset), settings).fit(
            network, on_epoch
        )


class _TorqueObjective(PlateauObjective[KnownTorques]):
    """The negative log-likelihood, less its part that statics alone decides."""

    def __init__(
        self, network: AnywhereStatics, samples: KnownTorques, settings: FitSettings
    ) -> None:
        super().__init__(network, samples, settings)
        self._network = network

    def losses(self, training: bool) -> Iterator[tuple[LossTerms, int]]:
        for batch in self.batches(training):
            losses = self._losses(batch)
            none = torch.zeros(())
            yield LossTerms(losses.mean(), none, none, none, none), len(losses)

    def _held_out_losses(self) -> Tensor:
        return torch.cat([self._losses(batch) for batch in self.batches(training=False)])

    def _losses(self, samples: KnownTorques) -> Tensor:
        """(B,), each less that of statics alone with a perfect fit."""
        chi_square, precision = self._misfit(samples)
        return 0.5 * (chi_square - torch.logdet(precision) + torch.logdet(samples.precision))

    @torch.no_grad()
    def calibrate(self) -> None:
        """Widen what is stated; the correction is kept only if the held-out samples confirm it."""
        learnt, heads = self._held_out_losses(), self._network.heads.weight
        kept = heads.clone()
        heads.zero_()
        gain = self._held_out_losses() - learnt
        if gain.mean() > _SURE * gain.std() / len(gain) ** 0.5:
            heads.copy_(kept)
        found = torch.cat([self._misfit(batch)[0] for batch in self.batches(training=False)])
        expected = chi2.ppf(_CALIBRATED_AT, self.held_out.torque_n_m.shape[1])
        wider = torch.sqrt(torch.quantile(found, _CALIBRATED_AT) / expected)
        # strong contacts leave slack cables, whose misfit is less than noise; weak ones do not
        self._network.spread.factor *= wider.clamp(min=1.0)

    def _misfit(self, samples: KnownTorques) -> tuple[Tensor, Tensor]:
        """chi² (B,) of what the contacts leave, and its precision (B, 2N, 2N)."""
        torque, precision = self._network.corrected(*samples)
        return (torque * (precision @ torque[..., None])[..., 0]).sum(1), precision
