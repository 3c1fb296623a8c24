"""The history-dependent estimator: samples along a motion in, one contact for each out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import (
    OUTPUTS,
    Estimate,
    Estimates,
    Estimator,
    SequenceEstimator,
)
from cablesense_training.inference.history_simulation import HistoryEstimator
from cablesense_training.inference.metadata import ANYWHERE, HISTORY_SIMULATED
from cablesense_training.inference.model_file import read_model
from cablesense_training.inference.session import NEXT_STATE, STATE


@dataclass(frozen=True)
class TemporalState:
    """Places of the parts in a state (…, size) of an arm with N segments and M cables.

    In order: the recurrent unit's own state; stop operators on the commanded cable lengths, a
    share from -1 to 1 for each cable and give; those lengths (M,) and the set-point (2N,); shares
    and set-point as they were at the tare; one where all this is known, and zero before that.

    `hidden` is the size of the first, and `shares` M times the number of gives.
    """

    hidden: int
    shares: int
    cables: int
    joints: int

    @classmethod
    def of_size(cls, size: int, hidden: int, cables: int, joints: int) -> TemporalState:
        """From the whole size."""
        return cls(hidden, (size - hidden - cables - 2 * joints - 1) // 2, cables, joints)

    @property
    def parts(self) -> tuple[int, ...]:
        """Sizes of the parts in their order."""
        shares, joints = self.shares, self.joints
        return (self.hidden, shares, self.cables, joints, shares, joints, 1)

    @property
    def size(self) -> int:
        """Of all parts together."""
        return sum(self.parts)

    def tared(self, state: Any) -> Any:
        """An array or tensor (…, size) after a tare: recurrent part empty, past commands kept."""
        taken_from = np.arange(self.size)
        ends = np.cumsum(self.parts)
        shares, set_point = taken_from[self.hidden : ends[1]], taken_from[ends[2] : ends[3]]
        taken_from[ends[3] : ends[5]] = np.concatenate([shares, set_point])
        tared = state[..., taken_from]
        tared[..., : self.hidden] = 0.0
        return tared


TEMPORAL_OUTPUTS = (*OUTPUTS, NEXT_STATE)

LONGEST_GAP_S, _LONGEST_GAP_TICKS = 1.0, 2.0
"""After a pause of the samples that is longer than both the past is forgotten."""

_EARLY = 0.25
"""Share of a tick by which a sample may be early: stamps jitter."""


class TemporalEstimator(SequenceEstimator):
    """A single-contact model that carries a state from tick to tick."""

    outputs = TEMPORAL_OUTPUTS

    def __init__(self, path: str | Path, arm: Arm | None = None) -> None:
        super().__init__(path, arm)
        self._stated = [*OUTPUTS, *self.beside, NEXT_STATE]
        size = self.metadata.arm.cable_count, self.metadata.arm.joint_count
        self._layout = TemporalState.of_size(self.metadata.memory, self.metadata.hidden, *size)
        self.forget()

    def forget(self) -> None:
        """See the base class."""
        self._state = np.zeros((1, self.metadata.memory))
        self._last_s: float | None = None

    def tare(self) -> None:
        """See the base class; what commands have drawn before stays known."""
        self._state = self._layout.tared(self._state)

    def _answer(self, inputs: dict[str, Array], time_s: float) -> Estimate:
        """See the base class.

        The state advances by whole ticks of the model, at the model's rate and not at that of the
        samples; one that comes sooner is answered from the state of the last tick and leaves it
        alone. The past ends where time runs back by over half a tick, or leaps by more than
        `LONGEST_GAP_S` and two ticks.
        """
        ticks = self._ticks_until(time_s)
        if ticks is None:
            self.forget()
        answers = [self._state]
        for _ in range(ticks or 1):
            answers = self._finite_outputs({**inputs, STATE: answers[-1]}, self._stated)
        if ticks != 0:
            self._state = answers[-1]
            # from where the tick is due, not from where it came: early ones would add up
            if self._last_s is None or ticks is None:
                self._last_s = time_s
            else:
                self._last_s += ticks * self.metadata.tick_s
        return Estimates.one([answer[0] for answer in answers[:-1]])

    def _ticks_until(self, time_s: float) -> int | None:
        """How many ticks a sample at this time completes; none without a history to continue."""
        if self._last_s is None:
            return None
        tick_s, passed_s = self.metadata.tick_s, time_s - self._last_s
        longest_s = max(LONGEST_GAP_S, _LONGEST_GAP_TICKS * tick_s)
        if not -0.5 * tick_s <= passed_s <= longest_s:
            return None
        return max(0, math.floor(passed_s / tick_s + _EARLY))


def open_estimator(path: str | Path, arm: Arm | None = None) -> Estimator | SequenceEstimator:
    """The estimator in a model file, history-dependent or not, for an arm where one is given.

    Raises:
        ModelFileError: the file is no single-contact model, or not one for this arm.
    """
    _, metadata = read_model(path)
    if metadata.network == HISTORY_SIMULATED:
        return HistoryEstimator.load(path, arm)
    if metadata.kind == ANYWHERE:
        return AnywhereEstimator.load(path, arm)
    return (TemporalEstimator if metadata.memory else Estimator).load(path, arm)
