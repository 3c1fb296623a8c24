"""Training of a history-dependent network along sequences in motion.

The network's state is carried from part to part of a sequence. `fit_interval` then fits what the
network states of its errors to sequences that were held out: two thirds of them train the head; on
the others its interval is moved until it holds as often as it states.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from cablesense_training.data.sequences import Sequences
from cablesense_training.errors import TrainingError
from cablesense_training.fit import (
    ROWS_AT_ONCE,
    FitHistory,
    FitSettings,
    Objective,
    OnEpoch,
    each,
    joined,
    take,
    torch_threads,
)
from cablesense_training.inference.estimator import NORMAL_95
from cablesense_training.networks.layers import (
    LossTerms,
    SingleContactOutput,
    SingleContactTarget,
    angle_error_deg,
    direction_of,
    gaussian_nll,
)
from cablesense_training.networks.temporal import (
    CorrectedAnswer,
    StatedInterval,
    Statement,
    TemporalNetwork,
    Ticks,
)

_JUDGED_EVERY = 10
"""The loss takes every tenth tick, as neighbours are alike."""

_RESET_SHARE = 0.05
"""Share of the parts that begin with an empty state, so that the network learns to answer without
a history."""


class SequenceSamples(NamedTuple):
    """S sequences of T ticks, all (S, T, …).

    Attributes:
        torque_n_m, true_torque_n_m: (S, T, 2N) by statics alone, and of the true contact.
        past: (S, T, `DrawnCables.past.size`) of the commands, known since before the tare.
    """

    ticks: Ticks
    torque_n_m: Tensor
    past: Tensor
    true_torque_n_m: Tensor
    target: SingleContactTarget

    @classmethod
    def of(cls, network: TemporalNetwork, sequences: Sequences) -> SequenceSamples:
        """The samples, for a network whose statics are those of the sequences' arm."""
        ticks = Ticks(*map(torch.as_tensor, sequences.inputs))
        truth_of = sequences.segment, sequences.angle_deg, sequences.magnitude_n
        target = SingleContactTarget(*map(torch.as_tensor, truth_of))
        flat = each(ticks, lambda part: part.flatten(0, 1))
        truth = each(target, torch.Tensor.flatten)
        parts = []
        with torch.no_grad():
            for rows in torch.arange(len(truth.segment)).split(ROWS_AT_ONCE):
                balance = network.balance(take(flat, rows))
                segment, angle_deg, magnitude_n = (part[rows] for part in truth)
                levers = network.closed_form.contact_levers(balance)
                levers = levers[torch.arange(len(rows)), (segment - 1).clamp(min=0)]
                force = direction_of(angle_deg) * magnitude_n[:, None]
                force = force.where((segment > 0)[:, None], 0.0)
                true = (force[:, None].to(levers.dtype) @ levers)[:, 0]
                parts.append((balance.torque_n_m, true))
        torque_n_m, true_torque_n_m = (
            torch.cat(part).unflatten(0, target.segment.shape) for part in zip(*parts, strict=True)
        )
        return cls(ticks, torque_n_m, _past(network, sequences), true_torque_n_m, target)


@torch.no_grad()
def _past(network: TemporalNetwork, sequences: Sequences) -> Tensor:
    """(S, T, size) along the ticks; the commands before them count, and the tare at the first."""
    set_points = sequences.before_rad, sequences.joint_command_rad
    path, first = torch.as_tensor(np.concatenate(set_points, axis=1)), set_points[0].shape[1]
    kinematics, drawn = network.closed_form.kinematics, network.drawn
    each_m = [kinematics(rows).length_m for rows in path.flatten(0, 1).split(ROWS_AT_ONCE)]
    lengths_m = torch.cat(each_m).unflatten(0, path.shape[:2])
    now, past = path.new_zeros(len(path), drawn.past.size), []
    for tick in range(path.shape[1]):
        now = drawn.follow(now, lengths_m[:, tick], path[:, tick])
        if tick == first:
            now = drawn.past.tared(now)
        past.append(now)
    return torch.stack(past[first:], dim=1)


def fit_sequences(
    network: TemporalNetwork,
    sequences: Sequences,
    settings: FitSettings,
    on_epoch: OnEpoch | None = None,
) -> FitHistory:
    """Train in place; the network keeps the weights of its best epoch, calibrated.

    Raises:
        TrainingError: fewer than four sequences, or a loss that is not finite.
    """
    if len(sequences) < 4:
        raise TrainingError(f"{len(sequences)} sequences are too few to train on; give at least 4")
    with torch_threads(settings.threads):
        return _SequenceObjective(network, sequences, settings).fit(network, on_epoch)


class _SequenceObjective(Objective[SequenceSamples]):
    """Truncated backpropagation through time: parts of sequences, the state carried on."""

    largest_gradient = 1.0
    held_out_share = 0.2

    def __init__(
        self, network: TemporalNetwork, sequences: Sequences, settings: FitSettings
    ) -> None:
        super().__init__(SequenceSamples.of(network, sequences), len(sequences), settings)
        self._network = network
        flat = each(self.training, lambda part: part.flatten(0, 1))
        network.adapt(flat.torque_n_m, flat.ticks, flat.torque_n_m - flat.true_torque_n_m)
        self.optimiser = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
        self._scheduler = torch.optim.lr_scheduler.CosineAnnealingLR(
            self.optimiser, settings.epochs
        )

    def losses(self, training: bool) -> Iterator[tuple[LossTerms, int]]:
        if not training:
            for answer, judged in self._held_out_answers():
                yield self._terms(answer, judged), 1
            return
        order = torch.randperm(len(self.training.torque_n_m), generator=self.generator)
        for rows in order.split(self.settings.batch_size):
            state = torch.zeros(len(rows), self._network.hidden)
            for part in self._parts(take(self.training, rows)):
                lost = torch.rand(len(rows), 1, generator=self.generator) < _RESET_SHARE
                phase = int(torch.randint(_JUDGED_EVERY, (1,), generator=self.generator))
                known = state.detach().masked_fill(lost, 0.0)
                answer, judged, state = self._answers(part, known, phase)
                yield self._terms(answer, judged), 1

    def end_epoch(self, held_out_loss: float) -> bool:
        self._scheduler.step()
        return False

    def calibrate(self) -> None:
        rows = []
        count = len(self.held_out.torque_n_m)
        with torch.no_grad():
            for answer, judged in self._held_out_answers():
                sequence = torch.arange(count).repeat_interleave(len(answer.seen) // count)
                rows.append(Answered(sequence, answer.seen, answer.output, judged.target))
        fit_interval(self._network.interval, joined(rows), self.generator)

    def _parts(self, samples: SequenceSamples) -> Iterator[SequenceSamples]:
        size = self.settings.part_ticks
        for start in range(0, samples.torque_n_m.shape[1], size):
            yield take(samples, (slice(None), slice(start, start + size)))

    def _held_out_answers(self) -> Iterator[tuple[CorrectedAnswer, SequenceSamples]]:
        state = torch.zeros(len(self.held_out.torque_n_m), self._network.hidden)
        for part in self._parts(self.held_out):
            answer, judged, state = self._answers(part, state, 0)
            yield answer, judged

    def _answers(
        self, part: SequenceSamples, state: Tensor, phase: int
    ) -> tuple[CorrectedAnswer, SequenceSamples, Tensor]:
        """Answers on the judged ticks, these ticks as flat rows, and the last state."""
        network, single = self._network, each(part, torch.Tensor.float)
        encoded = network.encode(single.torque_n_m, single.past, single.ticks)
        states, following = network.remember(encoded, state)

        def judged(values: Tensor) -> Tensor:
            return values[:, phase::_JUDGED_EVERY].flatten(0, 1)

        seen = each(part, judged)
        balance, speed_rad_s = network.balance(seen.ticks), seen.ticks.joint_speed_rad_s
        answer = network.answer(balance, judged(encoded), judged(states), speed_rad_s)
        return answer, seen, following

    def _terms(self, answer: CorrectedAnswer, judged: SequenceSamples) -> LossTerms:
        """The loss of the judged ticks; a newton of error weighs as much as a nat of the contact.

        The force is judged on the segment that is truly touched: that of another holds nothing
        about what to correct.
        """
        target = judged.target
        contact = functional.cross_entropy(answer.output.contact_logits, target.segment)
        touched = torch.nonzero(target.segment > 0)[:, 0]
        true_force = direction_of(target.angle_deg[touched]) * target.magnitude_n[touched, None]
        force = answer.force_n[touched, target.segment[touched] - 1]
        off_n = functional.huber_loss(force, true_force, reduction="sum") / max(1, len(touched))
        scale = self._network.error.std.double()
        error = answer.torque_n_m - judged.true_torque_n_m
        spread = gaussian_nll(error / scale, answer.torque_std_n_m / scale).mean()
        total = contact + off_n
        return LossTerms(total, contact, torch.zeros_like(total), off_n, spread)


_EITHER_SIDE = 0.025
"""Share of the forces below a 95 % interval, and above it."""

_FALSE_SHARE = 0.01
"""Largest share of an untouched arm among the ticks that are answered with a certain contact."""

_FITTED_SHARE = 2 / 3
_STEPS, _BATCH_ROWS = 1000, 512
_LEARNING_RATE, _WEIGHT_DECAY = 2e-3, 1e-3
_LEAST_OFF_DEG = 1e-3


class Answered(NamedTuple):
    """B ticks of numbered sequences (B,), answered as in `CorrectedAnswer`, with the truth."""

    sequence: Tensor
    seen: Tensor
    output: SingleContactOutput
    target: SingleContactTarget


def _pinball(error: Tensor, quantile: float) -> Tensor:
    """Loss of true less stated values, least at that quantile (Koenker and Bassett, 1978)."""
    return torch.maximum(quantile * error, (quantile - 1.0) * error)


def fit_interval(interval: StatedInterval, answered: Answered, generator: torch.Generator) -> None:
    """Train and calibrate the head in place, on held-out sequences."""
    count = int(answered.sequence.max()) + 1
    fitted = answered.sequence < max(1, round(_FITTED_SHARE * count))
    _train_head(interval, take(answered, fitted), generator)
    with torch.no_grad():
        _calibrate_head(interval, take(answered, ~fitted) if count > 1 else answered)


def _train_head(interval: StatedInterval, answered: Answered, generator: torch.Generator) -> None:
    interval.seen.adapt(answered.seen)
    optimiser = torch.optim.AdamW(
        interval.parameters(), lr=_LEARNING_RATE, weight_decay=_WEIGHT_DECAY
    )
    scheduler = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, _STEPS)
    for _ in range(_STEPS):
        rows = torch.randint(len(answered.seen), (_BATCH_ROWS,), generator=generator)
        batch = take(answered, rows)
        loss = _head_loss(interval(batch.seen, batch.output), batch)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        scheduler.step()


def _head_loss(stated: Statement, answered: Answered) -> Tensor:
    """The loss of quantiles and probability; the high end also bounds a force unseen."""
    touched = answered.target.segment > 0
    true = torch.asinh(answered.target.magnitude_n)
    none = functional.binary_cross_entropy_with_logits(stated.none_logit, (~touched).double())
    high = _pinball(true - stated.high, 1.0 - _EITHER_SIDE).mean()
    of_contacts = _pinball(true - stated.low, _EITHER_SIDE)
    of_contacts = of_contacts + _pinball(_log_ratio(stated, answered), 1.0 - 2.0 * _EITHER_SIDE)
    return none + high + of_contacts.where(touched, 0.0).sum() / touched.sum().clamp(min=1)


def _log_ratio(stated: Statement, answered: Answered) -> Tensor:
    """(B,) logarithm of the angle's error over half its stated interval."""
    off_deg = angle_error_deg(answered.output.direction, answered.target.angle_deg).abs()
    return torch.log(off_deg.clamp(min=_LEAST_OFF_DEG) / NORMAL_95) - stated.log_angle_std


def _calibrate_head(interval: StatedInterval, answered: Answered) -> None:
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
