"""True tensions along a course: in time by MuJoCo, or from rest to rest where the past counts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.arm import Arm
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.effects.chains import actuations, amended
from cablesense_sim.effects.entry import entries_of
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.quasi_static import QuasiStaticArm
from cablesense_training.motion.commanded_motion import STEP_S, CommandedMotion

Array = NDArray[np.float64]


def tensions_in_time_n(arm: Arm, motion: CommandedMotion, forces_n: Array) -> Array:
    """(T, M) tensions of an arm without memory under loads (T, N, 3), at rest at the start."""
    dynamics = ArmDynamics(arm, STEP_S)
    dynamics.reset(motion.angle_rad[0])
    found = np.empty((len(forces_n), arm.cable_count))
    for tick, loads in enumerate(forces_n):
        for segment, force in enumerate(loads, start=1):
            dynamics.load(segment, force)
        for angles in motion.fine_rad[tick]:
            dynamics.command(angles)
            dynamics.advance(STEP_S)
        found[tick] = dynamics.tensions_n
    return found


def tensions_from_rest_to_rest_n(
    arm: Arm,
    before_rad: Array,
    command_rad: Array,
    forces_n: Array,
    tick_s: float,
) -> Array:
    """(S, T, M) tensions of arms that remember, side by side, under loads (S, T, N, 3).

    Each goes through set-points (S, W, 2N) before those (S, T, 2N) that are asked for. NaN for
    sequences in which an arm finds no rest.
    """
    before = before_rad.swapaxes(0, 1)
    course = np.concatenate([before, command_rad.swapaxes(0, 1)])
    none = np.zeros((len(before), *forces_n.swapaxes(0, 1).shape[1:]))
    loads = np.concatenate([none, forces_n.swapaxes(0, 1)])
    found = np.full((*course.shape[:2], arm.cable_count), np.nan)
    rows = np.arange(course.shape[1])
    while rows.size:
        try:
            found[:, rows] = _through(arm, course[:, rows], loads[:, rows], tick_s)
        except EquilibriumError as error:
            if not error.failed.size:
                raise
            rows = np.delete(rows, error.failed)
            continue
        break
    return found[len(before) :].swapaxes(0, 1)


def _through(arm: Arm, course_rad: Array, loads_n: Array, tick_s: float) -> Array:
    entries, nominal = entries_of(arm), Mechanism.from_arm(arm)
    count = course_rad.shape[1]
    resting = QuasiStaticArm([amended(nominal, entries)] * count, [entries] * count)
    acting = actuations([entries] * count)
    found = np.empty((len(course_rad), count, arm.cable_count))
    for tick, command in enumerate(course_rad):
        held = held_lengths_m(nominal, command)
        for actuation in acting:
            held = actuation.step(tick * tick_s, held)
        found[tick] = resting.step(tick * tick_s, held, loads_n[tick])
    return found
