"""What a history-dependent network states of its errors, fitted to data that were held out.

Two thirds of the held-out sequences train the head; on the others its interval is moved until it
holds as often as it states, and the probability is found below which a contact is certain.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from cablesense_training.fit import take
from cablesense_training.inference.estimator import NORMAL_95
from cablesense_training.losses import SingleContactTarget, angle_error_deg, pinball
from cablesense_training.networks.layers import SingleContactOutput
from cablesense_training.networks.temporal import StatedInterval, Statement

_EITHER_SIDE = 0.025
"""Of the forces that lie below a 95 % interval, and above it."""

_FALSE_SHARE = 0.01
"""Of the ticks that are answered with a certain contact: so many may be of an untouched arm."""

_FITTED_SHARE = 2 / 3
_STEPS, _BATCH_ROWS = 1000, 512
_LEARNING_RATE, _WEIGHT_DECAY = 2e-3, 1e-3
_LEAST_OFF_DEG = 1e-3


class Answered(NamedTuple):
    """B ticks as a network has answered them.

    Attributes:
        sequence: (B,) which sequence a tick belongs to.
        seen: (B, features), as in `CorrectedAnswer`.
        output: the answers.
        target: the true contacts.
    """

    sequence: Tensor
    seen: Tensor
    output: SingleContactOutput
    target: SingleContactTarget


def fit_interval(interval: StatedInterval, answered: Answered, generator: torch.Generator) -> None:
    """Train and calibrate the head in place, on held-out sequences."""
    count = int(answered.sequence.max()) + 1
    fitted = answered.sequence < max(1, round(_FITTED_SHARE * count))
    _train(interval, take(answered, fitted), generator)
    with torch.no_grad():
        _calibrate(interval, take(answered, ~fitted) if count > 1 else answered)


def _train(interval: StatedInterval, answered: Answered, generator: torch.Generator) -> None:
    interval.seen.adapt(answered.seen)
    optimiser = torch.optim.AdamW(
        interval.parameters(), lr=_LEARNING_RATE, weight_decay=_WEIGHT_DECAY
    )
    scheduler = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, _STEPS)
    for _ in range(_STEPS):
        rows = torch.randint(len(answered.seen), (_BATCH_ROWS,), generator=generator)
        batch = take(answered, rows)
        loss = _loss(interval(batch.seen, batch.output), batch)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        scheduler.step()


def _loss(stated: Statement, answered: Answered) -> Tensor:
    """Of the quantiles and the probability; the high end bounds what may act unseen as well."""
    touched = answered.target.segment > 0
    true = torch.asinh(answered.target.magnitude_n)
    none = functional.binary_cross_entropy_with_logits(stated.none_logit, (~touched).double())
    high = pinball(true - stated.high, 1.0 - _EITHER_SIDE).mean()
    of_contacts = pinball(true - stated.low, _EITHER_SIDE)
    of_contacts = of_contacts + pinball(_log_ratio(stated, answered), 1.0 - 2.0 * _EITHER_SIDE)
    return none + high + of_contacts.where(touched, 0.0).sum() / touched.sum().clamp(min=1)


def _log_ratio(stated: Statement, answered: Answered) -> Tensor:
    """(B,) logarithm of the angle's error over half its stated interval."""
    off_deg = angle_error_deg(answered.output.direction, answered.target.angle_deg).abs()
    return torch.log(off_deg.clamp(min=_LEAST_OFF_DEG) / NORMAL_95) - stated.log_angle_std


def _calibrate(interval: StatedInterval, answered: Answered) -> None:
    stated, touched = interval(answered.seen, answered.output), answered.target.segment > 0
    none, true = torch.sigmoid(stated.none_logit), torch.asinh(answered.target.magnitude_n)
    by_none = none.argsort()
    untouched = (~touched[by_none]).cumsum(0) / torch.arange(1, len(none) + 1)
    certain = torch.nonzero(untouched <= _FALSE_SHARE)
    interval.surely.fill_(none[by_none[certain[-1, 0]]] if len(certain) else 0.0)
    stated_contact = none < interval.surely
    for end, (beyond, quantile) in enumerate(
        (
            ((stated.low - true)[stated_contact], 1.0 - _EITHER_SIDE),
            ((true - stated.high)[touched], 1.0 - _EITHER_SIDE),
            (_log_ratio(stated, answered)[stated_contact & touched], 1.0 - 2.0 * _EITHER_SIDE),
        )
    ):
        if len(beyond):
            interval.shift[end] += torch.quantile(beyond, quantile)
