"""Training: Adam, a learning rate that falls, the best weights kept, and calibrated spread.

Losses (4) to (8) are those of the paper.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from cablesense_base import Array
from cablesense_contact.estimate import NORMAL_95
from cablesense_training.data.dataset import Dataset
from cablesense_training.errors import TrainingError
from cablesense_training.networks.layers import (
    ContactNetwork,
    LossTerms,
    MultiContactTarget,
    SingleContactTarget,
    multi_contact_loss,
    multi_contact_ratios,
    single_contact_loss,
    single_contact_ratios,
)

ROWS_AT_ONCE = 8192
"""Samples that a network answers together outside training."""

_HELD_OUT_SHARE = 0.1
"""Of the samples, to choose the best epoch and to calibrate."""


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """How to train; refused with a `TrainingError` when out of range.

    Attributes:
        seed: of the validation split and the order of the batches.
        epochs: at most this many.
        batch_size: samples a step.
        learning_rate: of Adam, at the start.
        threads: of PyTorch; seed and number of threads determine the result.
        decay, patience, tolerance: λ, Δ and ε of equation (15): when the validation loss has not
            fallen below (1 - ε) of its best for Δ epochs, the learning rate is multiplied by λ.
            Read literally, (15) would set it to zero whenever the loss does improve.
        stop_patience: epochs without such an improvement after which training ends.
    """

    seed: int = 0
    epochs: int = 60
    batch_size: int = 512
    learning_rate: float = 2e-3
    threads: int = 2
    decay: float = 0.5
    patience: int = 2
    tolerance: float = 1e-3
    stop_patience: int = 12

    def __post_init__(self) -> None:
        for name in ("epochs", "batch_size", "threads"):
            if getattr(self, name) < 1:
                raise TrainingError(f"{name} = {getattr(self, name)}: must be at least 1")
        if not 0.0 < self.learning_rate <= 1.0:
            raise TrainingError(f"learning_rate = {self.learning_rate:g}: must be in (0, 1]")


class EpochRecord(NamedTuple):
    """One pass over the data: the loss on the held-out part, and means of its `LossTerms`."""

    epoch: int
    learning_rate: float
    validation: float
    total: float
    contact: float
    direction: float
    magnitude: float
    spread: float


OnEpoch = Callable[[EpochRecord], None]


@dataclass(frozen=True)
class FitHistory:
    """How the training went; the network keeps the weights of `best_epoch`."""

    epochs: tuple[EpochRecord, ...]
    best_epoch: int
    seconds: float

    @property
    def best_validation(self) -> float:
        """Validation loss of the weights kept."""
        return self.epochs[self.best_epoch - 1].validation


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """PyTorch computes on `count` threads in the block."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def fit(
    network: ContactNetwork,
    dataset: Dataset,
    settings: FitSettings | None = None,
    on_epoch: OnEpoch | None = None,
) -> FitHistory:
    """Train a network in place and leave it in evaluation mode with the best weights seen.

    Raises:
        TrainingError: the dataset does not fit the network, is too small to hold any of it out,
            or the loss is no longer finite.
    """
    settings = settings or FitSettings()
    with torch_threads(settings.threads):
        return _Training(network, dataset, settings).run(on_epoch)


def outputs_of(
    network: ContactNetwork, tension_difference_n: Array, command_rad: Array
) -> list[Tensor]:
    """A network's outputs for samples (B, M) and (B, 2N), in float64 and evaluation mode."""
    dtype = network.magnitude.std.dtype
    tension = torch.as_tensor(tension_difference_n).to(dtype).split(ROWS_AT_ONCE)
    command = torch.as_tensor(command_rad).to(dtype).split(ROWS_AT_ONCE)
    network.eval()
    with torch.no_grad():
        outputs = [network(*rows) for rows in zip(tension, command, strict=True)]
    return [torch.cat(parts).double() for parts in zip(*outputs, strict=True)]


class _Samples(NamedTuple):
    """What a network learns from, row by row."""

    tension_difference_n: Tensor
    joint_command_rad: Tensor
    target: SingleContactTarget | MultiContactTarget

    def rows(self, index: Tensor) -> _Samples:
        """Some of the rows, in that order."""
        target = type(self.target)(*(column[index] for column in self.target))
        return _Samples(self.tension_difference_n[index], self.joint_command_rad[index], target)


def _samples(network: ContactNetwork, dataset: Dataset) -> _Samples:
    _require_fitting(network, dataset)
    dtype = network.magnitude.std.dtype

    def real(values: object) -> Tensor:
        return torch.as_tensor(values).to(dtype)

    target: SingleContactTarget | MultiContactTarget
    if network.several:
        target = MultiContactTarget(real(dataset.contacts), real(dataset.magnitudes_n))
    else:
        segment = torch.as_tensor(dataset.segment, dtype=torch.int64)
        target = SingleContactTarget(segment, real(dataset.angle_deg), real(dataset.magnitude_n))
    return _Samples(real(dataset.tension_difference_n), real(dataset.command_rad), target)


def _require_fitting(network: ContactNetwork, dataset: Dataset) -> None:
    """Refuse a dataset of an arm of another size, or one too small to hold any of it out."""
    shape = (dataset.arm.cable_count, dataset.arm.segment_count)
    if shape != (network.cable_count, network.segment_count):
        raise TrainingError(
            f"the dataset is of arm {dataset.arm.identity} with {shape[0]} cables and {shape[1]} "
            f"segments; the network is for {network.cable_count} and {network.segment_count}"
        )
    if len(dataset) < 10:
        raise TrainingError(f"{len(dataset)} samples are too few to train on; give at least 10")


class _Training:
    """One network with its data, and the generator of all that is drawn."""

    def __init__(self, network: ContactNetwork, dataset: Dataset, settings: FitSettings) -> None:
        samples = _samples(network, dataset)
        self._network = network
        self._settings = settings
        self._generator = torch.Generator().manual_seed(settings.seed)
        order = torch.randperm(len(dataset), generator=self._generator)
        count = max(1, round(_HELD_OUT_SHARE * len(dataset)))
        self._training = samples.rows(order[count:])
        self._held_out = samples.rows(order[:count])
        network.adapt(self._training.tension_difference_n, self._training.target.magnitude_n)
        self._optimiser = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
        self._scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(
            self._optimiser,
            factor=settings.decay,
            patience=settings.patience,
            threshold=settings.tolerance,
        )

    def run(self, on_epoch: OnEpoch | None) -> FitHistory:
        """Train in place, keep the weights of the best epoch, calibrate the stated deviations."""
        start = time.perf_counter()
        network = self._network
        records: list[EpochRecord] = []
        best = math.inf
        best_epoch = 0
        best_state: dict[str, Tensor] = {}
        since_best = 0
        for epoch in range(1, self._settings.epochs + 1):
            rate = float(self._optimiser.param_groups[0]["lr"])
            network.train()
            means = self._pass()
            network.eval()
            held_out = self._held_out_loss()
            if not math.isfinite(held_out):
                raise TrainingError(
                    f"the loss is not finite in epoch {epoch}; lower the learning rate of {rate:g}"
                )
            records.append(EpochRecord(epoch, rate, held_out, *means))
            if on_epoch is not None:
                on_epoch(records[-1])
            if held_out < best:
                best = held_out
                best_epoch = epoch
                best_state = {name: value.clone() for name, value in network.state_dict().items()}
            before = self._scheduler.best
            self._scheduler.step(held_out)
            since_best = 0 if self._scheduler.best < before else since_best + 1
            if since_best >= self._settings.stop_patience:
                break
        network.load_state_dict(best_state)
        network.eval()
        self._calibrate()
        return FitHistory(tuple(records), best_epoch, time.perf_counter() - start)

    def _pass(self) -> list[float]:
        """One pass over the training data; the means of its loss terms."""
        sums = torch.zeros(len(LossTerms._fields))
        count = 0
        for terms, rows in self._losses(training=True):
            self._optimiser.zero_grad(set_to_none=True)
            (terms.total + terms.spread).backward()
            self._optimiser.step()
            sums = sums + torch.stack(terms).detach() * rows
            count += rows
        return [float(each) for each in sums / count]

    @torch.no_grad()
    def _held_out_loss(self) -> float:
        total = 0.0
        count = 0
        for terms, rows in self._losses(training=False):
            total += float(terms.total) * rows
            count += rows
        return total / count

    def _losses(self, training: bool) -> Iterator[tuple[LossTerms, int]]:
        """Losses with their weights in one pass over the training data, or the held-out."""
        loss = multi_contact_loss if self._network.several else single_contact_loss
        scale_n = self._network.magnitude.std
        for output, target in self._answers(training):
            yield loss(output, target, scale_n), len(target.magnitude_n)

    @torch.no_grad()
    def _calibrate(self) -> None:
        """Widen until 95 % of the held-out errors lie within 1.96 stated deviations."""
        ratios = multi_contact_ratios if self._network.several else single_contact_ratios
        ratio = torch.cat([ratios(*answer) for answer in self._answers(training=False)])
        for column, of_one in enumerate(ratio.unbind(1)):
            known = of_one[torch.isfinite(of_one)]
            if len(known):
                self._network.spread.factor[column] *= torch.quantile(known, 0.95) / NORMAL_95

    def _answers(self, training: bool) -> Iterator[tuple[Any, Any]]:
        """Answers and targets in batches, of the training data in another order each time."""
        samples = self._training if training else self._held_out
        count = len(samples.tension_difference_n)
        if training:
            order = torch.randperm(count, generator=self._generator)
            batches = order.split(self._settings.batch_size)
        else:
            batches = torch.arange(count).split(ROWS_AT_ONCE)
        for rows in batches:
            batch = samples.rows(rows)
            yield self._network(batch.tension_difference_n, batch.joint_command_rad), batch.target
