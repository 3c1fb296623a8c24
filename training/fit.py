"""Training: one loop for all networks, with Adam, the best weights kept and calibrated spread.

`fit` trains on samples, `fit_sequences` on sequences; `fit_anywhere` only calibrates. Losses (4)
to (8) are those of the paper.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import torch
from scipy.stats import chi2
from torch import Tensor

from cablesense_base import Array
from cablesense_training.data.dataset import Dataset
from cablesense_training.errors import TrainingError
from cablesense_training.inference.estimator import NORMAL_95
from cablesense_training.networks.closed_form import Balance
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
from cablesense_training.networks.statics import AnywhereStatics

ROWS_AT_ONCE = 8192
"""Samples that a network answers together outside training."""

_CALIBRATED_AT = 0.95
"""The share of samples of contacts anywhere whose misfit is made that of noise."""
_LEAST_DETERMINED = 0.1
"""Share of the median of the taut cables' least squared lever; below it, the pose shows what no
cable measures."""

Parts = TypeVar("Parts", bound=NamedTuple)


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """How to train; refused with a `TrainingError` when out of range.

    Attributes:
        seed: of the validation split and the order of the batches.
        epochs: at most this many.
        batch_size: samples, or sequences, a step.
        learning_rate: of Adam, at the start; along sequences it falls to nothing by a cosine.
        threads: of PyTorch; seed and number of threads determine the result.
        decay, patience, tolerance: λ, Δ and ε of equation (15): when the validation loss has not
            fallen below (1 - ε) of its best for Δ epochs, the learning rate is multiplied by λ.
            Read literally, (15) would set it to zero whenever the loss does improve.
        stop_patience: epochs without such an improvement after which training ends.
        part_ticks: ticks of a sequence through which gradients flow; the state flows through all.
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
    part_ticks: int = 60

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
        """Validation loss of the weights kept; NaN of a network that has nothing to train."""
        return self.epochs[self.best_epoch - 1].validation if self.epochs else math.nan


def each(parts: Parts, change: Callable[[Tensor], Tensor]) -> Parts:
    """A tree of named tuples, with every tensor in it changed."""
    return parts._make(
        change(part) if isinstance(part, Tensor) else each(part, change) for part in parts
    )


def take(parts: Parts, index: Tensor | tuple[slice, ...]) -> Parts:
    """A tree of named tuples, with every tensor indexed alike."""
    return each(parts, lambda part: part[index])


def joined(rows: Sequence[Parts]) -> Parts:
    """The rows of such trees, one after the other."""
    columns = zip(*rows, strict=True)
    return rows[0]._make(
        torch.cat(column) if isinstance(column[0], Tensor) else joined(column)
        for column in columns
    )


class Objective(ABC, Generic[Parts]):
    """Data and losses that a network is trained with, and the generator of all that is drawn."""

    optimiser: torch.optim.Optimizer | None = None
    """Of the trainable parameters; None where there are none."""
    largest_gradient = math.inf
    """Norm to which the gradients of a step are clipped."""
    held_out_share = 0.1
    """Of the rows, to choose the best epoch and to calibrate."""

    def __init__(self, samples: Parts, rows: int, settings: FitSettings) -> None:
        self.settings = settings
        self.generator = torch.Generator().manual_seed(settings.seed)
        order = torch.randperm(rows, generator=self.generator)
        count = max(1, round(self.held_out_share * rows))
        self.training = take(samples, order[count:])
        self.held_out = take(samples, order[:count])

    @abstractmethod
    def losses(self, training: bool) -> Iterator[tuple[LossTerms, int]]:
        """Losses with their weights in one pass over the training data, or the held-out."""

    @abstractmethod
    def end_epoch(self, held_out_loss: float) -> bool:
        """Adapt the learning rate; whether training ends here."""

    @abstractmethod
    def calibrate(self) -> None:
        """Make what the trained network states of its errors hold on the held-out data."""

    def fit(self, network: torch.nn.Module, on_epoch: OnEpoch | None) -> FitHistory:
        """Train in place, keep the weights of the best epoch, calibrate the stated deviations."""
        start = time.perf_counter()
        records: list[EpochRecord] = []
        best, best_epoch = math.inf, 0
        best_state: dict[str, Tensor] = {}
        for epoch in range(1, self.settings.epochs + 1 if self.optimiser is not None else 1):
            assert self.optimiser is not None
            rate = float(self.optimiser.param_groups[0]["lr"])
            network.train()
            sums, count = torch.zeros(len(LossTerms._fields)), 0
            for terms, rows in self.losses(training=True):
                self.optimiser.zero_grad(set_to_none=True)
                (terms.total + terms.spread).backward()
                if math.isfinite(self.largest_gradient):
                    torch.nn.utils.clip_grad_norm_(network.parameters(), self.largest_gradient)
                self.optimiser.step()
                sums, count = sums + torch.stack(terms).detach() * rows, count + rows
            network.eval()
            with torch.no_grad():
                losses = [(float(terms.total), n) for terms, n in self.losses(training=False)]
            held_out = sum(loss * rows for loss, rows in losses) / sum(n for _, n in losses)
            if not math.isfinite(held_out):
                raise TrainingError(
                    f"the loss is not finite in epoch {epoch}; lower the learning rate of {rate:g}"
                )
            records.append(EpochRecord(epoch, rate, held_out, *(sums / count).tolist()))
            if on_epoch is not None:
                on_epoch(records[-1])
            if held_out < best:
                best, best_epoch = held_out, epoch
                best_state = {name: value.clone() for name, value in network.state_dict().items()}
            if self.end_epoch(held_out):
                break
        if best_state:
            network.load_state_dict(best_state)
        network.eval()
        self.calibrate()
        return FitHistory(tuple(records), best_epoch, time.perf_counter() - start)


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

    One without trainable parameters is only calibrated, to the held-out errors.

    Raises:
        TrainingError: the dataset does not fit the network, is too small to hold any of it out,
            or the loss is no longer finite.
    """
    settings = settings or FitSettings()
    with torch_threads(settings.threads):
        return _SampleObjective(network, dataset, settings).fit(network, on_epoch)


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


class _TrainingSamples(NamedTuple):
    tension_difference_n: Tensor
    joint_command_rad: Tensor
    target: SingleContactTarget | MultiContactTarget


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
    _require_fitting(network, dataset)
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


def _samples(network: ContactNetwork, dataset: Dataset) -> _TrainingSamples:
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
    return _TrainingSamples(real(dataset.tension_difference_n), real(dataset.command_rad), target)


class _SampleObjective(Objective[_TrainingSamples]):
    """Losses (4) to (8), and a learning rate that falls where they no longer do."""

    def __init__(self, network: ContactNetwork, dataset: Dataset, settings: FitSettings) -> None:
        super().__init__(_samples(network, dataset), len(dataset), settings)
        self._network = network
        network.adapt(self.training.tension_difference_n, self.training.target.magnitude_n)
        self._since_best = 0
        if trainable := [part for part in network.parameters() if part.requires_grad]:
            self.optimiser = torch.optim.Adam(trainable, lr=settings.learning_rate)
            self._scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(
                self.optimiser,
                factor=settings.decay,
                patience=settings.patience,
                threshold=settings.tolerance,
            )

    def losses(self, training: bool) -> Iterator[tuple[LossTerms, int]]:
        loss = multi_contact_loss if self._network.several else single_contact_loss
        scale_n = self._network.magnitude.std
        for output, target in self._answers(training):
            yield loss(output, target, scale_n), len(target.magnitude_n)

    def end_epoch(self, held_out_loss: float) -> bool:
        best = self._scheduler.best
        self._scheduler.step(held_out_loss)
        self._since_best = 0 if self._scheduler.best < best else self._since_best + 1
        return self._since_best >= self.settings.stop_patience

    @torch.no_grad()
    def calibrate(self) -> None:
        ratios = multi_contact_ratios if self._network.several else single_contact_ratios
        every = torch.cat([ratios(*answer) for answer in self._answers(training=False)])
        # until 95 % of the errors lie within 1.96 stated deviations
        for column, ratio in enumerate(every.unbind(1)):
            if len(known := ratio[torch.isfinite(ratio)]):
                self._network.spread.factor[column] *= torch.quantile(known, 0.95) / NORMAL_95

    def _answers(self, training: bool) -> Iterator[tuple[Any, Any]]:
        """Answers and targets in batches, of the training data in another order each time."""
        samples = self.training if training else self.held_out
        count = len(samples.tension_difference_n)
        if training:
            order = torch.randperm(count, generator=self.generator)
            batches = order.split(self.settings.batch_size)
        else:
            batches = torch.arange(count).split(ROWS_AT_ONCE)
        for rows in batches:
            batch = take(samples, rows)
            yield self._network(batch.tension_difference_n, batch.joint_command_rad), batch.target
