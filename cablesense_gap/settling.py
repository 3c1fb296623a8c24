"""A new recording has a past of its own: history-dependent states, from its first rows.

Where in its play an actuator stands, what friction carries, how far creep has gone and where a
zero has drifted to belong to a recording, and not to the arm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablesense_base import Array
from cablesense_gap.arm_simulator import ArmSimulator, counted_rows
from cablesense_gap.recordings.recording import Recording, RecordingError
from cablesense_gap.verdict import removed_fraction
from cablesense_sim.arm import Arm, ListedEffect
from cablesense_sim.effects.effect import Parameter
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.replay import replay_arm

_PRIOR = 0.05
"""Of the floor: a state that the first rows do not show stays where nothing is known of it."""
_MOST_TRIALS = 12


def settled(arm: Arm, recording: Recording, rows: int) -> Arm:
    """The arm in the state in which the first `rows` of a recording show it to have begun.

    Raises:
        EquilibriumError: the arm finds no rest in these rows.
    """
    from scipy.optimize import least_squares

    states = _states(arm)
    if not states or rows < 1:
        return arm
    first = recording.rows(slice(0, rows))
    low, high = np.array([[p.low, p.high] for _, p in states]).T / (
        typical := np.array([p.typical for _, p in states])
    )
    begin = np.clip([p.default / p.typical for _, p in states], low + 1e-6, high - 1e-6)

    def left(scaled: Array) -> Array:
        begun = _begun(arm, states, scaled * typical)
        simulator = ArmSimulator(begun, first)
        residual = (first.tensions_n - simulator.predict([{}])[0]) / simulator.floor
        return np.concatenate(
            [np.nan_to_num(residual, nan=1e3).ravel(), _PRIOR * (scaled - begin)]
        )

    found = least_squares(
        left, begin, bounds=(low, high), x_scale=1.0, diff_step=0.02, max_nfev=_MOST_TRIALS
    )
    return _begun(arm, states, found.x * typical)


def removed_on(
    recording: Recording, nominal: Arm, amended: Arm, rows: int, floor_n: float
) -> float:
    """The share of the removable gap that an amended arm removes on a new recording of it.

    Its state is estimated from the first `rows`, which do not count.

    Raises:
        RecordingError: no rows are left to count.
        EquilibriumError: an arm finds no rest.
    """
    nominal_n, amended_n = (
        replay_arm(arm, recording.time_s, recording.command_rad, recording.forces_n)
        for arm in (nominal, settled(amended, recording, rows))
    )
    judged = counted_rows(nominal, recording, nominal_n)
    judged[:rows] = False
    if not judged.any():
        raise RecordingError(
            f"{recording.name}: no rows are left to judge behind the first {rows}; settle on fewer"
        )
    before_n, after_n = (
        float(np.sqrt(((recording.tensions_n - each)[judged] ** 2).mean()))
        for each in (nominal_n, amended_n)
    )
    return removed_fraction(before_n, after_n, floor_n)


def _states(arm: Arm) -> list[tuple[int, Parameter]]:
    """What the past has left: the effect's place in the arm's list, and the parameter."""
    found = []
    for k, listed in enumerate(arm.effects):
        effect = known_effects()[listed.effect]
        history = effect.history(arm.segment_count, arm.cable_count)
        found += [(k, p) for p in (*effect.parameters, *history) if p.past]
    return found


def _begun(arm: Arm, states: Sequence[tuple[int, Parameter]], values: Array) -> Arm:
    effects: list[ListedEffect] = list(arm.effects)
    for (k, parameter), value in zip(states, values, strict=True):
        numbers = {**effects[k].parameters, parameter.name: float(value)}
        effects[k] = effects[k].model_copy(update={"parameters": numbers})
    return arm.model_copy(update={"effects": effects})
