"""The history-dependent estimator: samples along a motion in, one contact for each out.

`TemporalState` is the layout of what such a model carries from tick to tick. `open_estimator`
opens any single-contact model file with the class that fits it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_training.inference.estimator import (
    OUTPUTS,
    Estimate,
    Estimates,
    Estimator,
    SequenceEstimator,
    finite_answers,
    finite_table,
)
from cablesense_training.inference.history_simulation import HistoryEstimator
from cablesense_training.inference.metadata import HISTORY_SIMULATED
from cablesense_training.inference.session import (
    ACCELERATION,
    COMMAND,
    NEXT_STATE,
    SPEED,
    STATE,
    TENSION,
    ModelSession,
    read_model,
)


@dataclass(frozen=True)
class TemporalState:
    """Places of the parts in a state (…, size) of an arm with N segments and M cables.

    In order: the recurrent unit's own state; stop operators on the commanded cable lengths, a
    share from -1 to 1 for each cable and give; those lengths (M,) and the set-point (2N,); shares
    and set-point as they were at the tare; one where all this is known, and zero before that.

    Attributes:
        hidden: size of the recurrent unit's state.
        shares: number of shares, M times the number of gives.
        cables, joints: M and 2N.
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

    def tared(self, state: Array) -> Array:
        """The state (…, size) right after a tare: recurrent part empty, past commands kept."""
        places = np.cumsum(self.parts)[:-1]
        hidden, shares, lengths, set_point, *_, known = np.split(state, places, axis=-1)
        parts = [np.zeros_like(hidden), shares, lengths, set_point, shares, set_point, known]
        return np.concatenate(parts, axis=-1)


TEMPORAL_OUTPUTS = (*OUTPUTS, NEXT_STATE)

LONGEST_GAP_S, _LONGEST_GAP_TICKS = 1.0, 2.0
"""After a pause of the samples that is longer than both the past is forgotten."""

_EARLY = 0.25
"""Share of a tick by which a sample may be early: stamps jitter."""


class TickClock:
    """Counts the whole ticks of a model between samples, whenever these come.

    Args:
        tick_s: how long a tick is.
    """

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._last_s: float | None = None

    def ticks(self, time_s: float) -> int | None:
        """How many ticks a sample at this time completes; none without a history to continue.

        It ends where time runs back by over half a tick, or leaps by more than `LONGEST_GAP_S` and
        two ticks.
        """
        if self._last_s is None:
            return None
        passed_s = time_s - self._last_s
        longest_s = max(LONGEST_GAP_S, _LONGEST_GAP_TICKS * self._tick_s)
        if not -0.5 * self._tick_s <= passed_s <= longest_s:
            return None
        return max(0, math.floor(passed_s / self._tick_s + _EARLY))

    def advance(self, time_s: float, ticks: int | None) -> None:
        """Advance to a time, with the number of ticks that `ticks` gave for it."""
        if self._last_s is None or ticks is None:
            self._last_s = time_s
        else:  # from where the tick is due, not from where it came: early ones would add up
            self._last_s += ticks * self._tick_s


class TemporalEstimator(SequenceEstimator):
    """A single-contact model that carries a state from tick to tick; for one thread at a time.

    Its state follows from the samples given since `forget`, their times and their set-points
    alone, so the same samples give the same answers again.
    """

    outputs = TEMPORAL_OUTPUTS

    def __init__(self, session: ModelSession) -> None:
        super().__init__(session)
        self._stated = [*OUTPUTS, *session.beside]
        arm, memory = self.metadata.arm, self.metadata.memory
        self._layout = TemporalState.of_size(
            memory, self.metadata.hidden, arm.cable_count, arm.joint_count
        )
        self._state = np.zeros((1, memory))
        self._clock = TickClock(self.metadata.tick_s)

    def forget(self) -> None:
        """Begin without a past."""
        self._state = np.zeros_like(self._state)
        self._clock = TickClock(self.metadata.tick_s)

    def tare(self) -> None:
        """Tension differences count from now on; what commands have drawn before stays known."""
        self._state = self._layout.tared(self._state)

    def estimate(
        self,
        tension_difference_n: ArrayLike,
        joint_command_rad: ArrayLike,
        joint_speed_rad_s: ArrayLike,
        joint_acceleration_rad_s2: ArrayLike,
        time_s: float,
    ) -> Estimate:
        """The contact behind tension differences (M,) at a set-point (2N,) in motion or at rest.

        The state advances by whole ticks of the model, at the model's rate and not at that of the
        samples; one that comes sooner is answered from the state of the last tick and leaves it
        alone. Where `TickClock` has the past end, a new one begins.

        Raises:
            EstimateError: a wrong shape, or numbers that are not finite.
        """
        ticks = self._clock.ticks(time_s)
        if ticks is None:
            self.forget()
        joints = self.metadata.arm.joint_count
        inputs = {
            TENSION: self._tensions(tension_difference_n, 1),
            COMMAND: finite_table(joint_command_rad, joints, "set-point angles", 1),
            SPEED: finite_table(joint_speed_rad_s, joints, "set-point speeds", 1),
            ACCELERATION: finite_table(joint_acceleration_rad_s2, joints, "accelerations", 1),
        }
        answers = [self._state]
        for _ in range(ticks or 1):
            answers = self._answers_of({**inputs, STATE: answers[-1]})
        if ticks != 0:
            self._state = answers[-1]
            self._clock.advance(time_s, ticks)
        return Estimate.of_outputs([answer[0] for answer in answers[:-1]])

    def estimate_sequences(
        self,
        tension_differences_n: Array,
        joint_commands_rad: Array,
        joint_speeds_rad_s: Array,
        joint_accelerations_rad_s2: Array,
        before_rad: Array,
    ) -> Estimates:
        """Estimates (S, T) of S sequences of T ticks side by side, inputs (S, T, …).

        Set-points (S, W, 2N) precede the samples, one a tick; the tare is that of the first tick.
        The estimator's own state is left alone.

        Raises:
            EstimateError: an answer is not finite.
        """
        inputs = {
            TENSION: tension_differences_n,
            COMMAND: joint_commands_rad,
            SPEED: joint_speeds_rad_s,
            ACCELERATION: joint_accelerations_rad_s2,
        }
        still = np.zeros_like(joint_commands_rad[:, 0])
        state = np.zeros((len(still), self.metadata.memory))
        for set_point in [*before_rad.swapaxes(0, 1), joint_commands_rad[:, 0]]:
            idle = {TENSION: np.zeros_like(tension_differences_n[:, 0]), COMMAND: set_point}
            idle |= {SPEED: still, ACCELERATION: still}
            state = self._session.run({**_contiguous(idle), STATE: state}, [NEXT_STATE])[-1]
        state = self._layout.tared(state)
        ticks = []
        for tick in range(tension_differences_n.shape[1]):
            now = _contiguous({name: values[:, tick] for name, values in inputs.items()})
            *answer, state = self._answers_of({**now, STATE: state})
            ticks.append(answer)
        answers = [np.stack(parts, axis=1) for parts in zip(*ticks, strict=True)]
        return Estimates.of_outputs(answers)

    def _answers_of(self, inputs: dict[str, Array]) -> list[Array]:
        """The stated outputs, and the next state last."""
        return finite_answers(self._session, inputs, [*self._stated, NEXT_STATE])


def _contiguous(inputs: dict[str, Array]) -> dict[str, Array]:
    return {k: np.ascontiguousarray(values, dtype=np.float64) for k, values in inputs.items()}


def open_estimator(path: str | Path, arm: Arm | None = None) -> Estimator | SequenceEstimator:
    """The estimator in a model file, history-dependent or not, for an arm where one is given.

    Raises:
        ModelFileError: the file is no single-contact model, or not one for this arm.
    """
    _, metadata = read_model(path)
    if metadata.network == HISTORY_SIMULATED:
        return HistoryEstimator.load(path, arm)
    return (TemporalEstimator if metadata.memory else Estimator).load(path, arm)
