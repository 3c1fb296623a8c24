"""Sequences as tensors, with the torques that statics makes of them and those that are true."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from cablesense_training.losses import SingleContactTarget, direction_of
from cablesense_training.motion.sequences import Sequences
from cablesense_training.networks.temporal import TemporalNetwork, Ticks
from cablesense_training.physics.closed_form import Balance

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
