"""Answers of an estimator along sequences, and their errors in motion and at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cablesense_training.data.sequences import Sequences
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    SingleContactMetrics,
    single_contact_metrics,
)
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.temporal_estimator import TemporalEstimator

Rows = TypeVar("Rows", ContactTruth, ContactAnswer)

SETTLED_S = 0.5
"""After so long without motion an arm counts as at rest, as the estimator node waits."""


@dataclass(frozen=True)
class SequenceMetrics:
    """Metrics over sequences.

    Attributes:
        every, moving, rest: over all ticks, those in motion or just after it, and the others.
        false_force_n, false_force_moving_n, false_force_rest_n: mean force answered where nothing
            touches.
    """

    every: SingleContactMetrics
    moving: SingleContactMetrics
    rest: SingleContactMetrics
    false_force_n: float
    false_force_moving_n: float
    false_force_rest_n: float


def sequence_answer(
    estimator: Estimator | TemporalEstimator, sequences: Sequences
) -> ContactAnswer:
    """Answers (S · T,) of an estimator; a memoryless one receives the set-point at every tick."""
    if isinstance(estimator, TemporalEstimator):
        found = estimator.estimate_sequences(
            sequences.tension_difference_n,
            sequences.joint_command_rad,
            sequences.joint_speed_rad_s,
            sequences.joint_acceleration_rad_s2,
            sequences.before_rad,
        )
    else:
        found = estimator.estimate_batch(
            sequences.tension_difference_n.reshape(-1, sequences.arm.cable_count),
            sequences.joint_command_rad.reshape(-1, sequences.arm.joint_count),
        )
    return ContactAnswer.of(found)


def sequence_metrics(answer: ContactAnswer, sequences: Sequences) -> SequenceMetrics:
    """The metrics of answers (S · T,), in motion and at rest."""
    truth = ContactTruth(
        sequences.segment.ravel(), sequences.angle_deg.ravel(), sequences.magnitude_n.ravel()
    )
    moving = unsettled(sequences).ravel()
    everywhere = np.ones_like(moving)

    def figures(rows: NDArray[np.bool_]) -> tuple[SingleContactMetrics, float]:
        chosen = (_rows(truth, rows), _rows(answer, rows))
        free = rows & (truth.segment == 0)
        force = np.where(answer.segment > 0, answer.magnitude_n, 0.0)[free]
        metrics = single_contact_metrics(*chosen, sequences.arm.segment_count)
        return metrics, float(force.mean()) if force.size else 0.0

    every, in_motion, at_rest = (figures(rows) for rows in (everywhere, moving, ~moving))
    return SequenceMetrics(every[0], in_motion[0], at_rest[0], every[1], in_motion[1], at_rest[1])


def unsettled(sequences: Sequences) -> NDArray[np.bool_]:
    """(S, T) whether the set-point moves, or did within the last `SETTLED_S`."""
    moving = (sequences.joint_speed_rad_s != 0.0).any(axis=-1)
    ticks = max(1, round(SETTLED_S / sequences.protocol.tick_s))
    padded = np.pad(moving, ((0, 0), (ticks - 1, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, ticks, axis=1)
    return np.asarray(windows.any(axis=-1))


def _rows(values: Rows, rows: NDArray[np.bool_]) -> Rows:
    return type(values)(**{name: column[rows] for name, column in vars(values).items()})
