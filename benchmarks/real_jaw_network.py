"""A small recurrent network that tells the jaw's torque from the drive's signals.

What it sees of each sample are the drive's torque, motor current and angle, the torque that the
amended physics gives, and the stops of the angle at ten radii, which hold what friction keeps of
the course. It is trained on simulations by the amended physics, then on the recordings. Its own
states are averages whose weights it chooses from what it sees,

    h <- h + g (m - h),    0 < g < 1,

so that it can hold a load while friction hides it, and cannot count. All T of them follow from a
parallel scan. It runs at 20 Hz, on five interleaved sequences of a recording at 100 Hz.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
import torch
from real_jaw_baselines import RADII_RAD, stops
from real_jaw_physics import STRIDE, PhysicsEstimator
from real_jaw_recordings import JawRecording, reference
from torch import Tensor, nn

from cablesense_base import Array

_SIMULATED = 48
_HIDDEN, _STATES = 48, 12
_BATCH, _WINDOW = 16, 200
_DECAY = 1e-4


class HeldAverages(nn.Module):
    """Signals (B, T, C) to a torque (B, T), both standardised, through averages that it holds."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            *(nn.Linear(channels, _HIDDEN), nn.Tanh()), *(nn.Linear(_HIDDEN, _HIDDEN), nn.Tanh())
        )
        self.gate, self.value = nn.Linear(_HIDDEN, _STATES), nn.Linear(_HIDDEN, _STATES)
        nn.init.constant_(self.gate.bias, -1.0)  # begins with memory
        self.head = nn.Sequential(
            *(nn.Linear(_HIDDEN + _STATES, _HIDDEN), nn.Tanh()), nn.Linear(_HIDDEN, 1)
        )
        self.direct = nn.Linear(channels + _STATES, 1)

    def forward(self, signals: Tensor) -> Tensor:
        """The torque of each sample, from the signals up to it."""
        seen = self.body(signals)
        gate, value = torch.sigmoid(self.gate(seen)), self.value(seen)
        gate = torch.cat([torch.ones_like(gate[:, :1]), gate[:, 1:]], dim=1)
        held = scan(1.0 - gate, gate * value)
        told = self.head(torch.cat([seen, held], -1)) + self.direct(torch.cat([signals, held], -1))
        return told[..., 0]


def scan(kept: Tensor, added: Tensor) -> Tensor:
    """h_t = kept_t h_(t-1) + added_t along axis 1 of (B, T, K), from h = 0, in log2 T passes."""
    reach = 1
    while reach < added.shape[1]:
        before, last = added[:, :-reach], kept[:, reach:]
        added = torch.cat([added[:, :reach], added[:, reach:] + last * before], dim=1)
        kept = torch.cat([kept[:, :reach], last * kept[:, :-reach]], dim=1)
        reach *= 2
    return added


class NetworkEstimator:
    """The network beside the physics of its tool, with the scales of the tool's signals."""

    def __init__(
        self,
        recordings: Sequence[JawRecording],
        physics: PhysicsEstimator,
        steps: int = 1000,
        seed: int = 0,
    ) -> None:
        """Train on recordings of the tool that `physics` is of, and of others with their own."""
        self._physics, self._steps, self._seed = physics, steps, seed
        torch.manual_seed(seed)
        self._network = HeldAverages(4 + len(RADII_RAD))
        own = reference(recordings)
        self._train([self._scaled(physics.simulated(own, _SIMULATED, seed))], steps // 2, 5e-3)
        sequences = [self._scaled(own)]
        for tool in {r.tool: None for r in recordings if r.tool != own[0].tool}:
            others = [r for r in recordings if r.tool == tool]
            sequences.append(self._beside(physics.adapted(others))._scaled(others))
        self._train(sequences, steps, 5e-3)

    def adapted(self, recordings: Sequence[JawRecording]) -> NetworkEstimator:
        """The network beside the physics of another tool, trained on with its recordings."""
        other = self._beside(self._physics.adapted(recordings))
        torch.manual_seed(self._seed)
        other._train([other._scaled(recordings)], self._steps // 5, 2e-3)
        return other

    def torques_nm(self, recordings: Sequence[JawRecording]) -> list[Array]:
        """The jaw's torque (T,) in each recording."""
        told = []
        for signals in self._signals(recordings):
            torque = np.empty(len(signals))
            for phase in range(STRIDE):
                sequence = torch.tensor(signals[None, phase::STRIDE], dtype=torch.float32)
                with torch.no_grad():
                    answer = self._network((sequence - self._mean) / self._scale)[0]
                torque[phase::STRIDE] = (answer * self._torque_scale + self._torque_mean).numpy()
            told.append(torque)
        return told

    def _beside(self, physics: PhysicsEstimator) -> NetworkEstimator:
        other = copy.deepcopy(self)
        other._physics = physics
        return other

    def _train(self, sequences: Sequence[tuple[Tensor, Tensor]], steps: int, rate: float) -> None:
        length = min(signals.shape[1] for signals, _ in sequences)
        signals = torch.cat([seen[:, :length] for seen, _ in sequences])
        torque = torch.cat([answer[:, :length] for _, answer in sequences])
        weights = list(self._network.parameters())
        optimiser = torch.optim.AdamW(weights, rate, weight_decay=_DECAY)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps)
        for _ in range(steps):
            drawn = torch.randint(len(signals), (_BATCH,))
            # a third of the windows begin where the recordings do
            first = max(0, int(torch.randint(-_WINDOW // 2, max(length - _WINDOW, 1), ())))
            window = slice(first, first + _WINDOW)
            told = self._network(signals[drawn, window])
            loss = ((told - torque[drawn, window]) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(weights, 1.0)
            optimiser.step()
            schedule.step()

    def _scaled(self, recordings: Sequence[JawRecording]) -> tuple[Tensor, Tensor]:
        """Signals (B, T, C) and torques (B, T) at 20 Hz in scales that are taken from them.

        Recordings are cut to the shortest.
        """
        length = min(len(r.drive_angle_rad) for r in recordings) // STRIDE
        seen, answers = [], []
        for recording, each in zip(recordings, self._signals(recordings), strict=True):
            for phase in range(STRIDE):
                seen.append(each[phase::STRIDE][:length])
                answers.append(recording.jaw_torque_nm[phase::STRIDE][:length])
        signals = torch.tensor(np.array(seen), dtype=torch.float32)
        torque = torch.tensor(np.array(answers), dtype=torch.float32)
        self._mean, self._scale = signals.mean((0, 1)), signals.std((0, 1))
        self._torque_mean, self._torque_scale = torque.mean(), torque.std()
        return (
            (signals - self._mean) / self._scale,
            (torque - self._torque_mean) / self._torque_scale,
        )

    def _signals(self, recordings: Sequence[JawRecording]) -> list[Array]:
        """(T, C) what the network sees of each recording."""
        seen = []
        for recording, told in zip(recordings, self._physics.torques_nm(recordings), strict=True):
            angle, torque = recording.drive_angle_rad, recording.drive_torque_nm
            measured = np.stack([torque, recording.motor_current_a, angle, told], axis=1)
            seen.append(np.hstack([measured, stops(angle)]))
        return seen
