"""Training of a history-dependent network along sequences in motion.

`SequenceSamples` are sequences as tensors, with the joint torques that statics makes of their
tensions and the true ones. The objective carries the network's state from part to part of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from cablesense_training.data.sequences import Sequences
from cablesense_training.errors import TrainingError
from cablesense_training.fit import (
    FitHistory,
    LoopSettings,
    Objective,
    OnEpoch,
    run_epochs,
    single_contact_ratios,
    split_rows,
    torch_threads,
)
from cablesense_training.losses import (
    LossTerms,
    SingleContactTarget,
    direction_of,
    gaussian_nll,
)
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
class SequenceFitSettings(LoopSettings):
    """How to train on sequences; the learning rate falls to nothing along a cosine.

    Attributes:
        part_ticks: ticks through which gradients flow; the state flows on through all.
        judged_every: the loss takes one tick in so many, as neighbours are alike.
        reset_share: of the parts that begin with an empty state, so that the network learns to
            answer without a past.
        force_scale_n: an error of the force that weighs as much as a nat of the contact.
    """

    epochs: int = 20
    batch_size: int = 32
    part_ticks: int = 60
    judged_every: int = 5
    reset_share: float = 0.05
    learning_rate: float = 3e-3
    force_scale_n: float = 1.0


_LARGEST_GRADIENT = 1.0


def fit_sequences(
    network: TemporalNetwork,
    sequences: Sequences,
    settings: SequenceFitSettings,
    on_epoch: OnEpoch | None = None,
) -> FitHistory:
    """Train in place; the network keeps the weights of its best epoch, calibrated.

    Raises:
        TrainingError: fewer than four sequences, or a loss that is not finite.
    """
    if len(sequences) < 4:
        raise TrainingError(f"{len(sequences)} sequences are too few to train on; give at least 4")
    with torch_threads(settings.threads):
        return run_epochs(_SequenceObjective(network, sequences, settings), settings, on_epoch)


class _SequenceObjective(Objective):
    """Truncated backpropagation through time: parts of sequences, the state carried on."""

    network: TemporalNetwork
    optimiser: torch.optim.Optimizer

    def __init__(
        self, network: TemporalNetwork, sequences: Sequences, settings: SequenceFitSettings
    ) -> None:
        self.network, self._settings = network, settings
        self._generator = torch.Generator().manual_seed(settings.seed)
        samples = SequenceSamples.of(network, sequences)
        training, held_out = split_rows(len(samples), settings, self._generator)
        every = slice(None)
        self._training = samples.part(training, every)
        self._held_out = samples.part(held_out, every)
        error = self._training.torque_n_m - self._training.true_torque_n_m
        network.adapt(
            self._training.torque_n_m.flatten(0, 1),
            self._training.ticks.flat(),
            error.flatten(0, 1),
        )
        self.optimiser = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
        self._scheduler = torch.optim.lr_scheduler.CosineAnnealingLR(
            self.optimiser, settings.epochs
        )

    def train_epoch(self) -> LossTerms:
        settings, generator = self._settings, self._generator
        order = torch.randperm(len(self._training), generator=generator)
        sums, count = torch.zeros(len(LossTerms._fields)), 0
        for rows in order.split(settings.batch_size):
            state = torch.zeros(len(rows), self.network.hidden)
            for ticks in self._parts(self._training):
                part = self._training.part(rows, ticks)
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

    def held_out_loss(self) -> float:
        totals = []
        state = torch.zeros(len(self._held_out), self.network.hidden)
        for ticks in self._parts(self._held_out):
            terms, state = self._terms(self._held_out.part(slice(None), ticks), state, 0)
            totals.append(float(terms.total))
        return sum(totals) / len(totals)

    def end_epoch(self, held_out_loss: float) -> bool:
        self._scheduler.step()
        return False

    def error_ratios(self) -> Tensor:
        ratios = []
        state = torch.zeros(len(self._held_out), self.network.hidden)
        for ticks in self._parts(self._held_out):
            part = self._held_out.part(slice(None), ticks)
            answer, target, _, state = self._answers(part, state, 0)
            ratios.append(single_contact_ratios(answer.output, target))
        return torch.cat(ratios)

    def _parts(self, samples: SequenceSamples) -> Iterator[slice]:
        ticks, size = samples.tick_count, self._settings.part_ticks
        for start in range(0, ticks, size):
            yield slice(start, min(start + size, ticks))

    def _terms(self, part: SequenceSamples, state: Tensor, phase: int) -> tuple[LossTerms, Tensor]:
        """The loss of the judged ticks, and the last state.

        The force is judged on the segment that is truly touched: where another was chosen, its
        force holds nothing about what to correct.
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
        total = contact + off_n / self._settings.force_scale_n
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
        judged = slice(phase, None, self._settings.judged_every)
        seen = part.part(slice(None), judged)
        balance = network.balance(seen.ticks.flat())
        answer = network.answer(
            balance, encoded[:, judged].flatten(0, 1), states[:, judged].flatten(0, 1)
        )
        target = SingleContactTarget(*(value.flatten() for value in seen.target))
        return answer, target, seen.true_torque_n_m.flatten(0, 1), following
