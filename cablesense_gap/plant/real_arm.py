"""A whole arm as it stands in a workshop, and what its sensors would say without noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.plant.actuation import Actuation, ideal_actuation
from cablesense_gap.plant.body import Body, stiff_body
from cablesense_gap.plant.geometry import cable_lengths_m
from cablesense_gap.plant.march import March
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.path import follow
from cablesense_gap.plant.protocol import Schedule
from cablesense_gap.plant.rubbing import Creep, Rubbing, firm, smooth
from cablesense_gap.plant.sensing import Sensing, ideal_sensing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RealArm:
    """An arm with whatever is wrong with it.

    Attributes:
        nominal: the arm as drawn, by which its actuators are commanded.
        body: joints, holes, masses, cables, springs.
        actuation: what the actuators make of commands.
        rubbing: friction.
        creep: of the cables.
        sensing: what the sensors make of tensions.
        load_turn: (3, 3) from the load that is written down to the one that acts.
    """

    nominal: Nominal
    body: Body
    actuation: Actuation
    rubbing: Rubbing
    creep: Creep
    sensing: Sensing
    load_turn: Array

    @property
    def remembers(self) -> bool:
        """Whether a rest depends on those before."""
        return self.rubbing.any or self.creep.any


def ideal_arm(nominal: Nominal) -> RealArm:
    """The arm exactly as drawn."""
    body = stiff_body(nominal)
    return RealArm(
        nominal=nominal,
        body=body,
        actuation=ideal_actuation(nominal.cable_count),
        rubbing=smooth(body),
        creep=firm(body),
        sensing=ideal_sensing(nominal.cable_count, nominal.pretension_n),
        load_turn=np.eye(3),
    )


def signals_n(arm: RealArm, schedule: Schedule, history: Schedule) -> Array:
    """(R, M) noise-free readings over a schedule, after a history that nobody saw.

    Raises:
        PlantError: the arm finds no rest in some row.
    """
    before = len(history.time_s)
    command = np.concatenate([history.command_rad, schedule.command_rad])
    time_s = np.concatenate([history.time_s, schedule.time_s])
    loads = np.concatenate([history.forces_n, schedule.forces_n]) @ arm.load_turn.T
    drawn = stiff_body(arm.nominal)
    straight = cable_lengths_m(drawn, np.zeros((1, command.shape[1])))
    wanted = cable_lengths_m(drawn, command) - straight
    paid_out = arm.actuation.paid_out_m(wanted, time_s)
    if arm.remembers:
        tension = _marched_n(arm, command, paid_out, loads, time_s)
    else:
        tension = follow(arm.body, command, paid_out, loads).tensions_n
    return arm.sensing.signals_n(np.maximum(tension[before:], 0.0), schedule.time_s)


def _marched_n(
    arm: RealArm, command: Array, paid_out: Array, loads: Array, time_s: Array
) -> Array:
    march = March(arm.body, arm.rubbing, arm.creep, arm.nominal.run_m)
    state = march.start(command[0], paid_out[0], loads[0])
    tension = np.empty_like(paid_out)
    tension[0] = state.tension_n[0]
    timeless = not arm.creep.any and arm.rubbing.breakaway == 1.0
    for row in range(1, len(tension)):
        still = np.array_equal(paid_out[row], paid_out[row - 1])
        if not (timeless and still and np.array_equal(loads[row], loads[row - 1])):
            period_s = float(time_s[row] - time_s[row - 1])
            state = march.advance(state, paid_out[row], loads[row], period_s)
        tension[row] = state.tension_n[0]
    return tension
