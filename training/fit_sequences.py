"""Training of a network with memory: along sequences, with the state carried from part to part.

Sequences as tensors, with the torques that statics makes of them and those that are true.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from cablesense_training.errors import TrainingError
from cablesense_training.fit import NORMAL_95, EpochRecord, FitHistory
from cablesense_training.losses import (
    LossTerms,
    SingleContactTarget,
    angle_error_deg,
    direction_of,
    gaussian_nll,
)
from cablesense_training.motion.sequences import Sequences
from cablesense_training.networks.closed_form import Balance
from cablesense_training.networks.temporal import CorrectedAnswer, TemporalNetwork, Ticks

_ROWS_AT_ONCE = 8192


@dataclass(frozen=True)
class SequenceSamples:
    """S sequences of T ticks.

    Attributes:
        ticks: inputs (S, T, …), float64.
        torque_n_m: (S, T, 2N) of the environment by statics alone, in the order of the joints.
        past: (S, T, `DrawnCables.size`) of the commands, known since before the tare.
        true_torque_n_m: (S, T, 2N) of the true contact.
        target: true contacts, each (S, T).
    """

    ticks: Ticks
    torque_n_m: Tensor
    past: Tensor
    true_torque_n_m: Tensor
    target: SingleContactTarget

    @classmethod
    def of(cls, network: TemporalNetwork, sequences: Sequences) -> SequenceSamples:
        """The samples, for a network whose statics are those of the sequences' arm."""
        ticks = Ticks(
            torch.as_tensor(sequences.tension_difference_n),
            torch.as_tensor(sequences.joint_command_rad),
            torch.as_tensor(sequences.joint_speed_rad_s),
            torch.as_tensor(sequences.joint_acceleration_rad_s2),
        )
        target = SingleContactTarget(
            torch.as_tensor(sequences.segment),
            torch.as_tensor(sequences.angle_deg),
            torch.as_tensor(sequences.magnitude_n),
        )
        flat, truth = ticks.flat(), SingleContactTarget(*(part.flatten() for part in target))
        torques, lengths, trues = [], [], []
        with torch.no_grad():
            for start in range(0, len(truth.segment), _ROWS_AT_ONCE):
                rows = slice(start, start + _ROWS_AT_ONCE)
                balance = network.balance(Ticks(*(part[rows] for part in flat)))
                lengths.append(balance.commanded_m)
                torques.append(network.joint_torque_n_m(balance))
                part = SingleContactTarget(*(value[rows] for value in truth))
                trues.append(network.in_joint_order(contact_torque_n_m(balance, part)))
        shape = (*target.segment.shape, -1)
        torque, length, true = (
            torch.cat(part).reshape(shape) for part in (torques, lengths, trues)
        )
        past = _past(network, sequences, length, ticks.joint_command_rad)
        return cls(ticks, torque, past, true, target)

    def __len__(self) -> int:
        return len(self.torque_n_m)

    @property
    def tick_count(self) -> int:
        """T."""
        return int(self.torque_n_m.shape[1])

    def part(self, rows: Tensor | slice, ticks: slice) -> SequenceSamples:
        """Some sequences, from some tick to another."""
        return SequenceSamples(
            Ticks(*(value[rows][:, ticks] for value in self.ticks)),
            self.torque_n_m[rows][:, ticks],
            self.past[rows][:, ticks],
            self.true_torque_n_m[rows][:, ticks],
            SingleContactTarget(*(value[rows][:, ticks] for value in self.target)),
        )


def contact_torque_n_m(balance: Balance, target: SingleContactTarget) -> Tensor:
    """(B, 2N) joint torques, pitches first, of true contacts; zero where nothing touches."""
    place = (target.segment - 1).clamp(min=0)
    levers = balance.lever[torch.arange(len(place)), place]
    force = direction_of(target.angle_deg) * target.magnitude_n[:, None]
    force = torch.where((target.segment > 0)[:, None], force, torch.zeros_like(force))
    torque: Tensor = (force[:, None].to(levers.dtype) @ levers)[:, 0]
    return torque


def _past(
    network: TemporalNetwork, sequences: Sequences, lengths_m: Tensor, set_points_rad: Tensor
) -> Tensor:
    """(S, T, size) along the ticks; the commands before them count, and the tare at the first."""
    before = torch.as_tensor(sequences.before_rad)
    drawn = network.drawn
    now = lengths_m.new_zeros(len(lengths_m), drawn.size)
    still = torch.zeros_like(lengths_m[:, 0])
    with torch.no_grad():
        for tick in range(before.shape[1]):
            pose = network.balance(Ticks(still, before[:, tick], before[:, tick], before[:, tick]))
            now = drawn.follow(now, pose.commanded_m, before[:, tick])
    past: list[Tensor] = []
    for tick in range(lengths_m.shape[1]):
        now = drawn.follow(now, lengths_m[:, tick], set_points_rad[:, tick])
        if not past:
            now = drawn.tared(now)
        past.append(now)
    return torch.stack(past, dim=1)


@dataclass(frozen=True, kw_only=True)
class SequenceFitSettings:
    """How to train.

    Attributes:
        seed: of the validation split, the order and the resets.
        epochs: passes over all sequences; the learning rate falls to nothing along a cosine.
        batch_size: sequences side by side.
        part_ticks: ticks through which gradients flow; the state flows on through all.
        judged_every: the loss looks at one tick in so many, as neighbours say the same.
        reset_share: of the parts that begin with an empty state, so that the network learns to
            find its way without a past.
        force_scale_n: an error of the force that weighs as much as a nat of the contact.
    """

    seed: int = 0
    epochs: int = 20
    batch_size: int = 32
    part_ticks: int = 60
    judged_every: int = 5
    reset_share: float = 0.05
    learning_rate: float = 3e-3
    force_scale_n: float = 1.0
    validation_share: float = 0.1
    threads: int = 2


_LARGEST_GRADIENT = 1.0


def fit_sequences(
    network: TemporalNetwork,
    sequences: Sequences,
    settings: SequenceFitSettings,
    on_epoch: Callable[[EpochRecord], None] | None = None,
) -> FitHistory:
    """Train in place; the network keeps the weights of its best epoch, calibrated.

    Raises:
        TrainingError: fewer than four sequences, or a loss that is not finite.
    """
    if len(sequences) < 4:
        raise TrainingError(f"{len(sequences)} sequences are too few to train on; give at least 4")
    before = torch.get_num_threads()
    torch.set_num_threads(settings.threads)
    try:
        return _Fit(network, sequences, settings).run(on_epoch)
    finally:
        torch.set_num_threads(before)


class _Fit:
    def __init__(
        self, network: TemporalNetwork, sequences: Sequences, settings: SequenceFitSettings
    ) -> None:
        self.network, self.settings = network, settings
        self.generator = torch.Generator().manual_seed(settings.seed)
        samples = SequenceSamples.of(network, sequences)
        order = torch.randperm(len(samples), generator=self.generator)
        held_out = max(1, round(settings.validation_share * len(samples)))
        every = slice(None)
        self.validation = samples.part(order[:held_out], every)
        self.training = samples.part(order[held_out:], every)
        error = self.training.torque_n_m - self.training.true_torque_n_m
        network.adapt(
            self.training.torque_n_m.flatten(0, 1),
            self.training.ticks.flat(),
            error.flatten(0, 1),
        )
        self.optimiser = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
        self.scheduler = torch.optim.lr_scheduler.CosineAnnealingLR(
            self.optimiser, settings.epochs
        )

    def run(self, on_epoch: Callable[[EpochRecord], None] | None) -> FitHistory:
        start, records = time.perf_counter(), []
        best, best_state = math.inf, {}
        best_epoch = 0
        for epoch in range(1, self.settings.epochs + 1):
            rate = float(self.optimiser.param_groups[0]["lr"])
            means = self._epoch()
            held_out = self._held_out_loss()
            if not math.isfinite(held_out):
                raise TrainingError(
                    f"the loss is not finite in epoch {epoch}; lower the rate of {rate:g}"
                )
            self.scheduler.step()
            records.append(
                EpochRecord(
                    epoch=epoch,
                    learning_rate=rate,
                    validation=held_out,
                    seconds=time.perf_counter() - start,
                    **{name: float(value) for name, value in means._asdict().items()},
                )
            )
            if on_epoch is not None:
                on_epoch(records[-1])
            if held_out < best:
                best, best_epoch = held_out, epoch
                state = self.network.state_dict()
                best_state = {name: value.clone() for name, value in state.items()}
        self.network.load_state_dict(best_state)
        self.network.eval()
        self._calibrate()
        return FitHistory(tuple(records), best_epoch, time.perf_counter() - start)

    def _epoch(self) -> LossTerms:
        self.network.train()
        settings, generator = self.settings, self.generator
        order = torch.randperm(len(self.training), generator=generator)
        sums, count = torch.zeros(len(LossTerms._fields)), 0
        for rows in order.split(settings.batch_size):
            state = torch.zeros(len(rows), self.network.hidden)
            for ticks in _parts(self.training.tick_count, settings.part_ticks):
                part = self.training.part(rows, ticks)
                lost = torch.rand(len(rows), 1, generator=generator) < settings.reset_share
                state = torch.where(lost, torch.zeros_like(state), state)
                phase = int(torch.randint(settings.judged_every, (1,), generator=generator))
                terms, state = self._terms(part, state, phase)
                self.optimiser.zero_grad(set_to_none=True)
                (terms.total + terms.spread).backward()
                torch.nn.utils.clip_grad_norm_(self.network.parameters(), _LARGEST_GRADIENT)
                self.optimiser.step()
                state = state.detach()
                sums, count = sums + torch.stack(terms).detach(), count + 1
        return LossTerms(*(sums / count))

    def _terms(self, part: SequenceSamples, state: Tensor, phase: int) -> tuple[LossTerms, Tensor]:
        """The loss of the judged ticks, and the last state.

        The force is judged on the segment that is truly touched: where another was believed in,
        its force says nothing of what to correct.
        """
        answer, target, true_torque, following = self._answers(part, state, phase)
        contact = functional.cross_entropy(answer.output.contact_logits, target.segment)
        touched = torch.nonzero(target.segment > 0)[:, 0]
        true_force = direction_of(target.angle_deg[touched]) * target.magnitude_n[touched, None]
        force = answer.force_n[touched, target.segment[touched] - 1]
        off_n = functional.huber_loss(force, true_force, reduction="sum") / max(1, len(touched))
        scale = self.network.error.std.double()
        error = self.network.in_joint_order(answer.torque_n_m) - true_torque
        spread = gaussian_nll(error / scale, answer.torque_std_n_m / scale).mean()
        total = contact + off_n / self.settings.force_scale_n
        return LossTerms(total, contact, torch.zeros_like(total), off_n, spread), following

    def _answers(
        self, part: SequenceSamples, state: Tensor, phase: int
    ) -> tuple[CorrectedAnswer, SingleContactTarget, Tensor, Tensor]:
        """Answers, truths and true torques of the judged ticks, and the last state."""
        network, kind = self.network, torch.float32
        encoded = network.encode(
            part.torque_n_m.to(kind),
            part.past.to(kind),
            Ticks(*(value.to(kind) for value in part.ticks)),
        )
        states, following = network.remember(encoded, state)
        judged = slice(phase, None, self.settings.judged_every)
        seen = part.part(slice(None), judged)
        balance = network.balance(seen.ticks.flat())
        answer = network.answer(
            balance, encoded[:, judged].flatten(0, 1), states[:, judged].flatten(0, 1)
        )
        target = SingleContactTarget(*(value.flatten() for value in seen.target))
        return answer, target, seen.true_torque_n_m.flatten(0, 1), following

    def _held_out_loss(self) -> float:
        """The loss along whole sequences."""
        with torch.no_grad():
            totals = []
            state = torch.zeros(len(self.validation), self.network.hidden)
            for ticks in _parts(self.validation.tick_count, self.settings.part_ticks):
                terms, state = self._terms(self.validation.part(slice(None), ticks), state, 0)
                totals.append(float(terms.total))
        return sum(totals) / len(totals)

    def _calibrate(self) -> None:
        """Scale the stated deviations until 95 % of the held-out errors lie within 1.96."""
        ratios = []
        state = torch.zeros(len(self.validation), self.network.hidden)
        with torch.no_grad():
            for ticks in _parts(self.validation.tick_count, self.settings.part_ticks):
                part = self.validation.part(slice(None), ticks)
                answer, target, _, state = self._answers(part, state, 0)
                output = answer.output
                found = (target.segment > 0) & (output.contact_logits.argmax(-1) > 0)
                off_n = (output.magnitude_n - target.magnitude_n).abs() / output.magnitude_std_n
                turned = angle_error_deg(output.direction, target.angle_deg).abs()
                ratios.append(torch.stack([off_n, turned / output.angle_std_deg], -1)[found])
            together = torch.cat(ratios)
            if len(together):
                self.network.spread.factor *= torch.quantile(together, 0.95, dim=0) / NORMAL_95


def _parts(ticks: int, size: int) -> Iterator[slice]:
    for start in range(0, ticks, size):
        yield slice(start, min(start + size, ticks))
