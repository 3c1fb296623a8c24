"""Training: one loop for all networks, with Adam, the best weights kept and calibrated spread.

`run_epochs` is the loop. What is trained on, samples or sequences, is an `Objective`: it holds the
data, split into a part to train on and a held-out part, and knows its losses. `fit` trains on the
samples of a dataset; `fit_sequences` in its own module on sequences in motion.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch
from torch import Tensor

from cablesense_base.progress import progress_bar
from cablesense_training.data.dataset import Dataset
from cablesense_training.errors import TrainingError
from cablesense_training.evaluation.metrics import NORMAL_95
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
from cablesense_training.networks.layers import SingleContactOutput
from cablesense_training.networks.temporal import TemporalNetwork

_ROWS_AT_ONCE = 8192


@dataclass(frozen=True, kw_only=True)
class LoopSettings:
    """What every training run has.

    Attributes:
        seed: of the validation split and the order of the batches.
        epochs: at most this many.
        batch_size: samples, or sequences, a step.
        learning_rate: of Adam, at the start.
        validation_share: part of the data held out to choose the best epoch and to calibrate.
        threads: of PyTorch; the result is the same for the same seed and the same number of
            threads.
    """

    seed: int = 0
    epochs: int
    batch_size: int
    learning_rate: float
    validation_share: float = 0.1
    threads: int = 2


@dataclass(frozen=True, kw_only=True)
class FitSettings(LoopSettings):
    """How to train on samples.

    Attributes:
        weights: α, β, γ of equation (8).
        decay, patience, tolerance: λ, Δ and ε of equation (15): when the validation loss has not
            fallen below (1 - ε) of its best for Δ epochs, the learning rate is multiplied by λ
            (`ReduceLROnPlateau`). Read literally, (15) would set the rate to zero whenever the
            loss does improve; the text means this.
        stop_patience: epochs without such an improvement after which training ends.
    """

    epochs: int = 60
    batch_size: int = 512
    learning_rate: float = 2e-3
    weights: LossWeights = field(default_factory=LossWeights)
    decay: float = 0.5
    patience: int = 2
    tolerance: float = 1e-3
    stop_patience: int = 12


@dataclass(frozen=True)
class EpochRecord:
    """One pass over the data: means of its losses, and the loss on the held-out part."""

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


OnEpoch = Callable[[EpochRecord], None]


class Objective(ABC):
    """Data and losses that a network is trained with.

    Attributes:
        network: trained in place.
        optimiser: of its trainable parameters; None where it has none.
    """

    network: Network | TemporalNetwork
    optimiser: torch.optim.Optimizer | None

    @abstractmethod
    def train_epoch(self) -> LossTerms:
        """One pass over the training data; means of the losses."""

    @abstractmethod
    def held_out_loss(self) -> float:
        """The loss on the held-out data; called without gradients."""

    @abstractmethod
    def end_epoch(self, held_out_loss: float) -> bool:
        """Adapt the learning rate; whether training ends here."""

    @abstractmethod
    def error_ratios(self) -> Tensor:
        """|error| / stated deviation (rows, outputs) of held-out data; NaN without a contact."""


def run_epochs(
    objective: Objective, settings: LoopSettings, on_epoch: OnEpoch | None
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
        means = objective.train_epoch()
        network.eval()
        with torch.no_grad():
            held_out = objective.held_out_loss()
        if not math.isfinite(held_out):
            raise TrainingError(
                f"the loss is not finite in epoch {epoch}; lower the learning rate of {rate:g}"
            )
        ends = objective.end_epoch(held_out)
        losses = {name: float(value) for name, value in means._asdict().items()}
        seconds = time.perf_counter() - start
        records.append(
            EpochRecord(
                epoch=epoch, learning_rate=rate, validation=held_out, seconds=seconds, **losses
            )
        )
        if on_epoch is not None:
            on_epoch(records[-1])
        if held_out < best:
            best, best_epoch = held_out, epoch
            best_state = {name: value.clone() for name, value in network.state_dict().items()}
        if ends:
            break
    if best_state:
        network.load_state_dict(best_state)
    network.eval()
    with torch.no_grad():
        _calibrate(network, objective.error_ratios())
    return FitHistory(tuple(records), best_epoch, time.perf_counter() - start)


def _calibrate(network: Network | TemporalNetwork, ratios: Tensor) -> None:
    """Scale the stated deviations until 95 % of the held-out errors lie within 1.96 of them."""
    for column in range(ratios.shape[1]):
        known = ratios[:, column][torch.isfinite(ratios[:, column])]
        if len(known):
            network.spread.factor[column] *= torch.quantile(known, 0.95) / NORMAL_95


def split_rows(
    rows: int, settings: LoopSettings, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Row numbers to train on, and those held out."""
    order = torch.randperm(rows, generator=generator)
    held_out = max(1, round(settings.validation_share * rows))
    return order[held_out:], order[:held_out]


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """PyTorch computes on so many threads in the block."""
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
    samples = _Samples.of(network, dataset)
    with torch_threads(settings.threads):
        return run_epochs(_SampleObjective(network, samples, settings), settings, on_epoch)


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
        dtype = next(network.parameters()).dtype

        def real(values: object) -> Tensor:
            return torch.as_tensor(values).to(dtype)

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

    def batches(self, size: int, order: Tensor | None = None) -> Iterator[_Samples]:
        order = torch.arange(len(self)) if order is None else order
        for chosen in order.split(size):
            yield self.rows(chosen)


class _SampleObjective(Objective):
    """Losses (4) to (8) on shuffled batches; plateau scheduler and early stopping."""

    network: Network

    def __init__(self, network: Network, samples: _Samples, settings: FitSettings) -> None:
        self.network, self._settings = network, settings
        self._generator = torch.Generator().manual_seed(settings.seed)
        training, held_out = split_rows(len(samples), settings, self._generator)
        self._training, self._held_out = samples.rows(training), samples.rows(held_out)
        network.adapt(self._training.tension_difference_n, self._training.target.magnitude_n)
        self._mark, self._since_mark = math.inf, 0
        trainable = [part for part in network.parameters() if part.requires_grad]
        self.optimiser = None
        if trainable:
            self.optimiser = torch.optim.Adam(trainable, lr=settings.learning_rate)
            self._scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(
                self.optimiser,
                factor=settings.decay,
                patience=settings.patience,
                threshold=settings.tolerance,
            )

    def train_epoch(self) -> LossTerms:
        assert self.optimiser is not None
        order = torch.randperm(len(self._training), generator=self._generator)
        sums = torch.zeros(len(LossTerms._fields))
        for batch in self._training.batches(self._settings.batch_size, order):
            terms = self._loss(batch)
            self.optimiser.zero_grad(set_to_none=True)
            (terms.total + terms.spread).backward()
            self.optimiser.step()
            sums += torch.stack(terms).detach() * len(batch)
        return LossTerms(*(sums / len(self._training)))

    def held_out_loss(self) -> float:
        batches = self._held_out.batches(_ROWS_AT_ONCE)
        total = sum(float(self._loss(batch).total) * len(batch) for batch in batches)
        return total / len(self._held_out)

    def end_epoch(self, held_out_loss: float) -> bool:
        self._scheduler.step(held_out_loss)
        if held_out_loss < (1.0 - self._settings.tolerance) * self._mark:
            self._mark, self._since_mark = held_out_loss, 0
        else:
            self._since_mark += 1
        return self._since_mark >= self._settings.stop_patience

    def error_ratios(self) -> Tensor:
        batches = self._held_out.batches(_ROWS_AT_ONCE)
        return torch.cat([self._error_ratios(batch) for batch in batches])

    def _loss(self, batch: _Samples) -> LossTerms:
        output = self.network(batch.tension_difference_n, batch.joint_command_rad)
        scale, weights = self.network.magnitude.std, self._settings.weights
        if isinstance(batch.target, MultiContactTarget):
            return multi_contact_loss(output, batch.target, scale, weights)
        return single_contact_loss(output, batch.target, scale[0], weights)

    def _error_ratios(self, batch: _Samples) -> Tensor:
        output = self.network(batch.tension_difference_n, batch.joint_command_rad)
        if not isinstance(batch.target, MultiContactTarget):
            return single_contact_ratios(output, batch.target)
        ratio = (output.magnitude_n - batch.target.magnitude_n).abs() / output.magnitude_std_n
        found = (batch.target.touched > 0) & (output.contact_logits > 0)
        return torch.where(found, ratio, torch.full_like(ratio, math.nan))


def single_contact_ratios(output: SingleContactOutput, target: SingleContactTarget) -> Tensor:
    """|error| / stated deviation (B, 2) of magnitude and angle; NaN where no contact was found."""
    force = (output.magnitude_n - target.magnitude_n).abs() / output.magnitude_std_n
    angle = angle_error_deg(output.direction, target.angle_deg).abs() / output.angle_std_deg
    ratio = torch.stack([force, angle], dim=-1)
    found = ((target.segment > 0) & (output.contact_logits.argmax(-1) > 0))[:, None]
    return torch.where(found, ratio, torch.full_like(ratio, math.nan))


@contextmanager
def epoch_progress(epochs: int, *, shown: bool) -> Iterator[OnEpoch]:
    """A bar of `epochs` at most, with the losses, on standard error; call it after every epoch.

    Nothing is drawn unless `shown` and standard error is a terminal.
    """
    with progress_bar(epochs, shown=shown, what="epochs") as advance:
        yield lambda record: advance(
            1,
            f"loss {record.total:.4f} (contact {record.contact:.4f}, "
            f"direction {record.direction:.4f}, magnitude {record.magnitude:.4f}), "
            f"held out {record.validation:.4f}, rate {record.learning_rate:.1e}",
        )
