"""Training: one loop for all networks, with Adam, the best weights kept and calibrated spread.

`run_epochs` is the loop. An `Objective` is the data, samples or sequences: it holds the data,
split into a part to train on and a held-out part, and knows its losses. `fit` trains on the
samples of a dataset; `fit_sequences` in its own module on sequences in motion.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import torch
from torch import Tensor

from cablesense_training.data.dataset import Dataset
from cablesense_training.errors import TrainingError
from cablesense_training.inference.estimator import NORMAL_95
from cablesense_training.losses import (
    LossTerms,
    MultiContactTarget,
    SingleContactTarget,
    multi_contact_loss,
    multi_contact_ratios,
    single_contact_loss,
    single_contact_ratios,
)
from cablesense_training.networks import MultiContactNetwork, Network
from cablesense_training.networks.temporal import TemporalNetwork

ROWS_AT_ONCE = 8192
"""Samples that a network answers together outside training."""


Parts = TypeVar("Parts", bound=NamedTuple)


@dataclass(frozen=True, kw_only=True)
class LoopSettings:
    """What every training run has; refused with a `TrainingError` when out of range.

    Attributes:
        seed: of the validation split and the order of the batches.
        epochs: at most this many.
        batch_size: samples, or sequences, a step.
        learning_rate: of Adam, at the start.
        threads: of PyTorch; the result is the same for the same seed and the same number of
            threads.
    """

    seed: int = 0
    epochs: int
    batch_size: int
    learning_rate: float
    threads: int = 2

    def __post_init__(self) -> None:
        for name in ("epochs", "batch_size", "threads"):
            if getattr(self, name) < 1:
                raise TrainingError(f"{name} = {getattr(self, name)}: must be at least 1")
        if not 0.0 < self.learning_rate <= 1.0:
            raise TrainingError(f"learning_rate = {self.learning_rate:g}: must be in (0, 1]")


@dataclass(frozen=True, kw_only=True)
class FitSettings(LoopSettings):
    """How to train on samples.

    Attributes:
        decay, patience, tolerance: λ, Δ and ε of equation (15): when the validation loss has not
            fallen below (1 - ε) of its best for Δ epochs, the learning rate is multiplied by λ
            (`ReduceLROnPlateau`). Read literally, (15) would set the rate to zero whenever the
            loss does improve; the text means this.
        stop_patience: epochs without such an improvement after which training ends.
    """

    epochs: int = 60
    batch_size: int = 512
    learning_rate: float = 2e-3
    decay: float = 0.5
    patience: int = 2
    tolerance: float = 1e-3
    stop_patience: int = 12


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
        """Validation loss of the weights kept; NaN of a network that has nothing to train."""
        return self.epochs[self.best_epoch - 1].validation if self.epochs else math.nan


def each(parts: Parts, change: Callable[[Tensor], Tensor]) -> Parts:
    """A named tuple of tensors, or of such tuples, with every tensor changed."""
    return parts._make(
        change(part) if isinstance(part, Tensor) else each(part, change) for part in parts
    )


def take(parts: Parts, index: Tensor | tuple[slice, ...]) -> Parts:
    """A named tuple of tensors, or of such tuples, with every tensor indexed alike."""
    return each(parts, lambda part: part[index])


def joined(rows: Sequence[Parts]) -> Parts:
    """Named tuples as `take` has them, one after the other."""
    columns = zip(*rows, strict=True)
    return rows[0]._make(
        torch.cat(column) if isinstance(column[0], Tensor) else joined(column)
        for column in columns
    )


class Objective(ABC, Generic[Parts]):
    """Data and losses that a network is trained with.

    Attributes:
        network: trained in place.
        training, held_out: the data.
        generator: of all that is drawn.
        optimiser: of the trainable parameters; None where there are none.
        largest_gradient: norm to which the gradients of a step are clipped.
        held_out_share: of the rows, to choose the best epoch and to calibrate.
    """

    network: Network | TemporalNetwork
    optimiser: torch.optim.Optimizer | None = None
    largest_gradient = math.inf
    held_out_share = 0.1

    def __init__(self, samples: Parts, rows: int, settings: LoopSettings) -> None:
        self.generator = torch.Generator().manual_seed(settings.seed)
        order = torch.randperm(rows, generator=self.generator)
        count = max(1, round(self.held_out_share * rows))
        self.training = take(samples, order[count:])
        self.held_out = take(samples, order[:count])

    @abstractmethod
    def training_losses(self) -> Iterator[tuple[LossTerms, int]]:
        """One pass over the training data: losses with their weights, a step after each."""

    @abstractmethod
    def held_out_losses(self) -> Iterator[tuple[LossTerms, int]]:
        """Losses with their weights."""

    @abstractmethod
    def end_epoch(self, held_out_loss: float) -> bool:
        """Adapt the learning rate; whether training ends here."""

    @abstractmethod
    def calibrate(self) -> None:
        """Make what the trained network states of its errors hold on the held-out data."""


def run_epochs(
    objective: Objective[Any], settings: LoopSettings, on_epoch: OnEpoch | None
) -> FitHistory:
    """Train, keep the weights of the best epoch and calibrate the stated deviations.

    Raises:
        TrainingError: the loss is no longer finite.
    """
    start = time.perf_counter()
    network, optimiser = objective.network, objective.optimiser
    records: list[EpochRecord] = []
    best, best_epoch = math.inf, 0
    best_state: dict[str, Tensor] = {}
    for epoch in range(1, settings.epochs + 1 if optimiser is not None else 1):
        assert optimiser is not None
        rate = float(optimiser.param_groups[0]["lr"])
        network.train()
        means = _train_epoch(objective, optimiser)
        network.eval()
        with torch.no_grad():
            losses = [(float(terms.total), rows) for terms, rows in objective.held_out_losses()]
        held_out = sum(loss * rows for loss, rows in losses) / sum(rows for _, rows in losses)
        if not math.isfinite(held_out):
            raise TrainingError(
                f"the loss is not finite in epoch {epoch}; lower the learning rate of {rate:g}"
            )
        records.append(EpochRecord(epoch, rate, held_out, *means))
        if on_epoch is not None:
            on_epoch(records[-1])
        if held_out < best:
            best, best_epoch = held_out, epoch
            best_state = {name: value.clone() for name, value in network.state_dict().items()}
        if objective.end_epoch(held_out):
            break
    if best_state:
        network.load_state_dict(best_state)
    network.eval()
    objective.calibrate()
    return FitHistory(tuple(records), best_epoch, time.perf_counter() - start)


def _train_epoch(objective: Objective[Any], optimiser: torch.optim.Optimizer) -> list[float]:
    """Means of the `LossTerms` of one pass over the training data, a step of Adam after each."""
    sums, count = torch.zeros(len(LossTerms._fields)), 0
    for terms, rows in objective.training_losses():
        optimiser.zero_grad(set_to_none=True)
        (terms.total + terms.spread).backward()
        if math.isfinite(objective.largest_gradient):
            parameters = objective.network.parameters()
            torch.nn.utils.clip_grad_norm_(parameters, objective.largest_gradient)
        optimiser.step()
        sums, count = sums + torch.stack(terms).detach() * rows, count + rows
    means: list[float] = (sums / count).tolist()
    return means


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
    network: Network,
    dataset: Dataset,
    settings: FitSettings | None = None,
    on_epoch: OnEpoch | None = None,
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
    with torch_threads(settings.threads):
        return run_epochs(_SampleObjective(network, dataset, settings), settings, on_epoch)


class _TrainingSamples(NamedTuple):
    """Tensors whose rows belong together."""

    tension_difference_n: Tensor
    joint_command_rad: Tensor
    target: SingleContactTarget | MultiContactTarget


def _samples(network: Network, dataset: Dataset) -> _TrainingSamples:
    shape = (dataset.arm.cable_count, dataset.arm.segment_count)
    if shape != (network.cable_count, network.segment_count):
        raise TrainingError(
            f"the dataset is of arm {dataset.arm.identity} with {shape[0]} cables and {shape[1]} "
            f"segments; the network is for {network.cable_count} and {network.segment_count}"
        )
    if len(dataset) < 10:
        raise TrainingError(f"{len(dataset)} samples are too few to train on; give at least 10")
    dtype = next(network.parameters()).dtype

    def real(values: object) -> Tensor:
        return torch.as_tensor(values).to(dtype)

    target: SingleContactTarget | MultiContactTarget
    if isinstance(network, MultiContactNetwork):
        target = MultiContactTarget(real(dataset.contacts), real(dataset.magnitudes_n))
    else:
        segment = torch.as_tensor(dataset.segment, dtype=torch.int64)
        target = SingleContactTarget(segment, real(dataset.angle_deg), real(dataset.magnitude_n))
    return _TrainingSamples(real(dataset.tension_difference_n), real(dataset.command_rad), target)


class _SampleObjective(Objective[_TrainingSamples]):
    """Losses (4) to (8) on shuffled batches; plateau scheduler and early stopping."""

    network: Network

    def __init__(self, network: Network, dataset: Dataset, settings: FitSettings) -> None:
        super().__init__(_samples(network, dataset), len(dataset), settings)
        self.network, self._settings = network, settings
        self._since_best = 0
        several = isinstance(network, MultiContactNetwork)
        self._loss: Callable[..., LossTerms] = (
            multi_contact_loss if several else single_contact_loss
        )
        self._ratios: Callable[..., Tensor] = (
            multi_contact_ratios if several else single_contact_ratios
        )
        network.adapt(self.training.tension_difference_n, self.training.target.magnitude_n)
        if trainable := [part for part in network.parameters() if part.requires_grad]:
            self.optimiser = torch.optim.Adam(trainable, lr=settings.learning_rate)
            self._scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(
                self.optimiser,
                factor=settings.decay,
                patience=settings.patience,
                threshold=settings.tolerance,
            )

    def training_losses(self) -> Iterator[tuple[LossTerms, int]]:
        order = torch.randperm(len(self.training.tension_difference_n), generator=self.generator)
        return self._losses(self.training, order.split(self._settings.batch_size))

    def held_out_losses(self) -> Iterator[tuple[LossTerms, int]]:
        return self._losses(self.held_out, self._held_out_batches())

    def end_epoch(self, held_out_loss: float) -> bool:
        best = self._scheduler.best
        self._scheduler.step(held_out_loss)
        self._since_best = 0 if self._scheduler.best < best else self._since_best + 1
        return self._since_best >= self._settings.stop_patience

    @torch.no_grad()
    def calibrate(self) -> None:
        answers = self._answers(self.held_out, self._held_out_batches())
        ratios_of = torch.cat([self._ratios(output, target) for output, target in answers])
        # until 95 % of the errors lie within 1.96 stated deviations
        for column, ratios in enumerate(ratios_of.unbind(1)):
            if len(known := ratios[torch.isfinite(ratios)]):
                self.network.spread.factor[column] *= torch.quantile(known, 0.95) / NORMAL_95

    def _held_out_batches(self) -> tuple[Tensor, ...]:
        return torch.arange(len(self.held_out.tension_difference_n)).split(ROWS_AT_ONCE)

    def _answers(
        self, samples: _TrainingSamples, batches: Iterable[Tensor]
    ) -> Iterator[tuple[Any, Any]]:
        """Outputs and targets, batch by batch."""
        for rows in batches:
            batch = take(samples, rows)
            yield self.network(batch.tension_difference_n, batch.joint_command_rad), batch.target

    def _losses(
        self, samples: _TrainingSamples, batches: Iterable[Tensor]
    ) -> Iterator[tuple[LossTerms, int]]:
        for output, target in self._answers(samples, batches):
            scale = self.network.magnitude.std
            yield self._loss(output, target, scale), len(target.magnitude_n)
