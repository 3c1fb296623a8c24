"""What statics cannot carry of an amended arm, taken off its readings by replaying its past.

A sample of an arm with friction, creep or a slow sensor cannot be told without what went before.
Commands are known, and loads are once they are estimated: so the amended arm is replayed under
the loads that were estimated so far, with all of its effects and with those on the arm itself
alone. The difference is taken off the readings, and the loads are estimated again, some times
over. A reading is corrected by what came before it and itself, never by what came after.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.recording import Recording
from cablesense_gap.tared_loads import TaredLoads, tared_loads
from cablesense_sim.arm import Arm
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.equilibrium import EquilibriumError
from cablesense_sim.replay import replay_arm

Array = NDArray[np.float64]

PASSES = 4

Answering = Callable[[TaredLoads], Array]
"""From loads to estimated forces (B, N, 3), base frame."""


def arm_alone(arm: Arm) -> Arm:
    """The arm with those of its effects that statics carries: those on the arm itself."""
    known = known_effects()
    kept = [e for e in arm.effects if known[e.effect].acts_on == "arm"]
    return arm.model_copy(update={"effects": kept})


def answers_with_past(recording: Recording, arm: Arm, answer: Answering) -> Array:
    """Forces (B, N, 3) on the loads of a recording (`tared_loads`), estimated with the past known.

    `answer` is an estimator for `arm_alone(arm)`. Unloaded rows are known to be so, as the tare is
    taken on them. Where the arm finds no rest under what was estimated, the last answers stand.
    """
    alone = arm_alone(arm)
    loads = tared_loads(recording)
    answers = answer(loads)
    if len(alone.effects) == len(arm.effects):
        return answers
    for _ in range(PASSES):
        forces = np.zeros((len(recording), *answers.shape[1:]))
        forces[loads.row] = answers
        try:
            whole, part = (
                replay_arm(each, recording.time_s, recording.command_rad, forces)
                for each in (arm, alone)
            )
        except EquilibriumError:
            break
        corrected = replace(recording, tensions_n=recording.tensions_n - (whole - part))
        answers = answer(tared_loads(corrected))
    return answers
