"""Training: Adam, a plateau scheduler, early stopping, and a calibrated uncertainty.

A progress bar for training: epoch, losses, learning rate and time left, on standard error.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch
from torch import Tensor

from cablesense_base.progress import progress_bar
from cablesense_training.data.dataset import Dataset
from cablesense_training.errors import TrainingError
from cablesense_training.losses import (
    LossTerms,
    LossWeights,
    MultiContactTarget,
    SingleContactTarget,
    angle_error_deg,
    multi_contact_loss,
    single_contact_loss,
)
from cablesense_training.networks import MultiContactNetwork, Network

NORMAL_95 = 1.959964
"""Standard deviations on either side of the mean that hold 95 % of a Gaussian."""


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """How to train.

    Attributes:
        seed: of the validation split and the order of the batches.
        epochs: at most this many.
        batch_size: samples a step.
        learning_rate: of Adam, at the start.
        weights: α, β, γ of equation (8).
        decay, patience, tolerance: λ, Δ and ε of equation (15): when the validation loss has not
            fallen below (1 - ε) of its best for Δ epochs, the learning rate is multiplied by λ
            (`ReduceLROnPlateau`). Read literally, (15) would set the rate to zero whenever the
            loss does improve; the text means this.
        stop_patience: epochs without such an improvement after which training ends.
        validation_share: part of the samples held out to steer all that.
        threads: of PyTorch; the result is the same for the same seed and the same number of
            threads.
    """

    seed: int = 0
    epochs: int = 60
    batch_size: int = 512
    learning_rate: float = 2e-3
    weights: LossWeights = field(default_factory=LossWeights)
    decay: float = 0.5
    patience: int = 2
    tolerance: float = 1e-3
    stop_patience: int = 12
    validation_share: float = 0.1
    threads: int = 2


@dataclass(frozen=True)
class EpochRecord:
    """One pass over the data; losses are means over it, `validation` is (8) on the rest."""

    epoch: int
    learning_rate: float
    total: float
    contact: float
    direction: float
    magnitude: float
    spread: float
    validation: float
    seconds: float


@dataclass(frozen=True)
class FitHistory:
    """How the training went; the network keeps the weights of `best_epoch`."""

    epochs: tuple[EpochRecord, ...]
    best_epoch: int
    seconds: float

    @property
    def best_validation(self) -> float:
        """Validation loss of the weights kept; NaN of a network that has nothing to train."""
        return self.epochs[self.best_epoch - 1].validation if self.epochs else math.nan


def fit(
    network: Network,
    dataset: Dataset,
    settings: FitSettings | None = None,
    on_epoch: Callable[[EpochRecord], None] | None = None,
) -> FitHistory:
    """Train a network in place and leave it in evaluation mode with the best weights seen.

    A network without trainable parameters is only calibrated: its stated deviations are scaled
    to the held-out errors.

    Args:
        network: a single-contact network, or a multi-contact one; the dataset's labels are read
            accordingly.
        dataset: samples of the arm that the network is for.
        settings: how to train; the defaults suit 100,000 samples and two processor cores.
        on_epoch: called after every epoch.

    Raises:
        TrainingError: the dataset does not fit the network, is too small to hold any of it out,
            or the loss is no longer finite.
    """
    settings = settings or FitSettings()
    samples = _Samples.of(network, dataset)
    with _threads(settings.threads):
        return _fit(network, samples, settings, on_epoch)


@dataclass(frozen=True)
class _Samples:
    """Tensors whose rows belong together."""

    tension_difference_n: Tensor
    joint_command_rad: Tensor
    target: SingleContactTarget | MultiContactTarget

    @classmethod
    def of(cls, network: Network, dataset: Dataset) -> _Samples:
        shape = (dataset.arm.cable_count, dataset.arm.segment_count)
        if shape != (network.cable_count, network.segment_count):
            raise TrainingError(
                f"the dataset is of arm {dataset.arm.identity} with {shape[0]} cables and "
                f"{shape[1]} segments; the network is for {network.cable_count} and "
                f"{network.segment_count}"
            )
        if len(dataset) < 10:
            raise TrainingError(
                f"{len(dataset)} samples are too few to train on; give at least 10"
            )
        real = _to(next(network.parameters()).dtype)
        target: SingleContactTarget | MultiContactTarget
        if isinstance(network, MultiContactNetwork):
            target = MultiContactTarget(real(dataset.contacts), real(dataset.magnitudes_n))
        else:
            target = SingleContactTarget(
                torch.as_tensor(dataset.segment, dtype=torch.int64),
                real(dataset.angle_deg),
                real(dataset.magnitude_n),
            )
        return cls(real(dataset.tension_difference_n), real(dataset.command_rad), target)

    def __len__(self) -> int:
        return len(self.tension_difference_n)

    def rows(self, chosen: Tensor) -> _Samples:
        target = type(self.target)(*(part[chosen] for part in self.target))
        return _Samples(self.tension_difference_n[chosen], self.joint_command_rad[chosen], target)

    def batches(self, size: int) -> Iterator[_Samples]:
        for start in range(0, len(self), size):
            yield self.rows(torch.arange(start, min(start + size, len(self))))


def _fit(
    network: Network,
    samples: _Samples,
    settings: FitSettings,
    on_epoch: Callable[[EpochRecord], None] | None,
) -> FitHistory:
    start = time.perf_counter()
    generator = torch.Generator().manual_seed(settings.seed)
    order = torch.randperm(len(samples), generator=generator)
    held_out = max(1, round(settings.validation_share * len(samples)))
    validation, training = samples.rows(order[:held_out]), samples.rows(order[held_out:])
    network.adapt(training.tension_difference_n, training.target.magnitude_n)
    trainable = [part for part in network.parameters() if part.requires_grad]
    if not trainable:
        network.eval()
        _calibrate(network, validation)
        return FitHistory((), 0, time.perf_counter() - start)

    optimiser = torch.optim.Adam(trainable, lr=settings.learning_rate)
    scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(
        optimiser,
        factor=settings.decay,
        patience=settings.patience,
        threshold=settings.tolerance,
    )
    records: list[EpochRecord] = []
    best = mark = math.inf
    best_epoch = mark_epoch = 0
    best_state: dict[str, Tensor] = {}
    for epoch in range(1, settings.epochs + 1):
        rate = float(optimiser.param_groups[0]["lr"])
        means = _train_epoch(network, training, settings, optimiser, generator)
        held_out_loss = _validation_loss(network, validation, settings.weights)
        if not math.isfinite(held_out_loss):
            raise TrainingError(
                f"the loss is not finite in epoch {epoch}; lower the learning rate of {rate:g}"
            )
        scheduler.step(held_out_loss)
        seconds = time.perf_counter() - start
        records.append(_record(epoch, rate, means, held_out_loss, seconds))
        if on_epoch is not None:
            on_epoch(records[-1])
        if held_out_loss < best:
            best, best_epoch = held_out_loss, epoch
            best_state = {name: value.clone() for name, value in network.state_dict().items()}
        if held_out_loss < (1.0 - settings.tolerance) * mark:
            mark, mark_epoch = held_out_loss, epoch
        if epoch - mark_epoch >= settings.stop_patience:
            break
    network.load_state_dict(best_state)
    network.eval()
    _calibrate(network, validation)
    return FitHistory(tuple(records), best_epoch, time.perf_counter() - start)


def _record(
    epoch: int, rate: float, means: LossTerms, validation: float, seconds: float
) -> EpochRecord:
    losses = {name: float(value) for name, value in means._asdict().items()}
    return EpochRecord(
        epoch=epoch, learning_rate=rate, validation=validation, seconds=seconds, **losses
    )


def _train_epoch(
    network: Network,
    training: _Samples,
    settings: FitSettings,
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
) -> LossTerms:
    network.train()
    order = torch.randperm(len(training), generator=generator)
    sums = torch.zeros(len(LossTerms._fields))
    for start in range(0, len(order), settings.batch_size):
        batch = training.rows(order[start : start + settings.batch_size])
        terms = _loss(network, batch, settings.weights)
        optimiser.zero_grad(set_to_none=True)
        (terms.total + terms.spread).backward()
        optimiser.step()
        sums += torch.stack(terms).detach() * len(batch)
    return LossTerms(*(sums / len(training)))


def _validation_loss(network: Network, validation: _Samples, weights: LossWeights) -> float:
    network.eval()
    total = 0.0
    with torch.no_grad():
        for batch in validation.batches(8192):
            total += float(_loss(network, batch, weights).total) * len(batch)
    return total / len(validation)


def _loss(network: Network, batch: _Samples, weights: LossWeights) -> LossTerms:
    output = network(batch.tension_difference_n, batch.joint_command_rad)
    scale = network.magnitude.std
    if isinstance(batch.target, MultiContactTarget):
        return multi_contact_loss(output, batch.target, scale, weights)
    return single_contact_loss(output, batch.target, scale[0], weights)


def _calibrate(network: Network, validation: _Samples) -> None:
    """Scale the stated deviations until 95 % of the held-out errors lie within 1.96 of them."""
    with torch.no_grad():
        ratios = torch.cat([_error_ratios(network, batch) for batch in validation.batches(8192)])
        for column in range(ratios.shape[1]):
            known = ratios[:, column][torch.isfinite(ratios[:, column])]
            if len(known):
                network.spread.factor[column] *= torch.quantile(known, 0.95) / NORMAL_95


def _error_ratios(network: Network, batch: _Samples) -> Tensor:
    """|error| / stated deviation (B, outputs) where a contact was found, NaN elsewhere."""
    output = network(batch.tension_difference_n, batch.joint_command_rad)
    target = batch.target
    if isinstance(target, MultiContactTarget):
        ratio = (output.magnitude_n - target.magnitude_n).abs() / output.magnitude_std_n
        found = (target.touched > 0) & (output.contact_logits > 0)
    else:
        ratio = torch.stack(
            [
                (output.magnitude_n - target.magnitude_n).abs() / output.magnitude_std_n,
                angle_error_deg(output.direction, target.angle_deg).abs() / output.angle_std_deg,
            ],
            dim=-1,
        )
        found = ((target.segment > 0) & (output.contact_logits.argmax(-1) > 0))[:, None]
    return torch.where(found, ratio, torch.full_like(ratio, math.nan))


def _to(dtype: torch.dtype) -> Callable[[object], Tensor]:
    """Turns arrays into tensors of the precision that the network computes in."""
    return lambda values: torch.as_tensor(values).to(dtype)


@contextmanager
def _threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def epoch_progress(epochs: int, *, shown: bool) -> Iterator[Callable[[EpochRecord], None]]:
    """A bar of `epochs` at most; call what it gives after every epoch.

    Nothing is drawn unless `shown` and standard error is a terminal.
    """
    with progress_bar(epochs, shown=shown, what="epochs") as advance:
        yield lambda record: advance(1, losses_line(record))


def losses_line(record: EpochRecord) -> str:
    """One epoch's losses in one line."""
    return (
        f"loss {record.total:.4f} (contact {record.contact:.4f}, "
        f"direction {record.direction:.4f}, magnitude {record.magnitude:.4f}), "
        f"held out {record.validation:.4f}, rate {record.learning_rate:.1e}"
    )
