"""A small recurrent network that tells the jaw's torque from the drive's signals.

What it sees of each sample are the drive's torque, motor current and angle, and the stops of the
angle at ten radii, which hold what friction remembers of the course. Its own states are averages
whose weights it chooses from what it sees,

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
from real_jaw_recordings import JawRecording
from torch import Tensor, nn

from cablesense_base import Array

STRIDE = 5
_HIDDEN, _STATES = 48, 12
_BATCH = 25
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
    """The network with the scales of its tool's signals."""

    def __init__(
        self, recordings: Sequence[JawRecording], steps: int = 1500, seed: int = 0
    ) -> None:
        """Train on recordings of one tool or several."""
        self._steps, self._seed = steps, seed
        torch.manual_seed(seed)
        self._network = HeldAverages(3 + len(RADII_RAD))
        self._train(recordings, steps, 5e-3)

    def adapted(self, recordings: Sequence[JawRecording]) -> NetworkEstimator:
        """The network with the scales of another tool, trained on with its recordings."""
        other = copy.deepcopy(self)
        torch.manual_seed(self._seed)
        other._train(recordings, self._steps // 5, 2e-3)
        return other

    def torques_nm(self, recordings: Sequence[JawRecording]) -> list[Array]:
        """The jaw's torque (T,) in each recording."""
        told = []
        for recording in recordings:
            signals, torque = _signals(recording), np.empty(len(recording.drive_angle_rad))
            for phase in range(STRIDE):
                sequence = torch.tensor(signals[None, phase::STRIDE], dtype=torch.float32)
                with torch.no_grad():
                    answer = self._network((sequence - self._mean) / self._scale)[0]
                torque[phase::STRIDE] = (answer * self._torque_scale + self._torque_mean).numpy()
            told.append(torque)
        return told

    def _train(self, recordings: Sequence[JawRecording], steps: int, rate: float) -> None:
        signals, torque = _sequences(recordings)
        self._mean, self._scale = signals.mean((0, 1)), signals.std((0, 1))
        self._torque_mean, self._torque_scale = torque.mean(), torque.std()
        signals = (signals - self._mean) / self._scale
        torque = (torque - self._torque_mean) / self._torque_scale
        weights = list(self._network.parameters())
        optimiser = torch.optim.AdamW(weights, rate, weight_decay=_DECAY)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps)
        for _ in range(steps):
            drawn = torch.randint(len(signals), (min(_BATCH, len(signals)),))
            loss = ((self._network(signals[drawn]) - torque[drawn]) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(weights, 1.0)
            optimiser.step()
            schedule.step()


def _sequences(recordings: Sequence[JawRecording]) -> tuple[Tensor, Tensor]:
    """Signals (B, T, C) and torques (B, T) at 20 Hz, cut to the shortest recording."""
    length = min(len(r.drive_angle_rad) for r in recordings) // STRIDE
    signals, torques = [], []
    for recording in recordings:
        seen = _signals(recording)
        for phase in range(STRIDE):
            signals.append(seen[phase::STRIDE][:length])
            torques.append(recording.jaw_torque_nm[phase::STRIDE][:length])
    return (
        torch.tensor(np.array(signals), dtype=torch.float32),
        torch.tensor(np.array(torques), dtype=torch.float32),
    )


def _signals(recording: JawRecording) -> Array:
    """(T, C) what the network sees."""
    measured = [recording.drive_torque_nm, recording.motor_current_a, recording.drive_angle_rad]
    return np.hstack([np.stack(measured, axis=1), stops(recording.drive_angle_rad)])
