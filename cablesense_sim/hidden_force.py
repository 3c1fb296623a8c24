"""The force that friction hides: the smallest change that the readings show.

While a cable sticks at its first guide its run keeps its tension, and the sensor at the actuator
reads no change. The change of force that readings show depends on pose and history. It is found by
simulation: the arm rests under one force, then under another, each time from the same friction
state (`cablesense_sim.quasi_static`).
"""

from __future__ import annotations

from copy import deepcopy
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import actuations, amended
from cablesense_sim.equilibrium import checked_command, held_lengths_m
from cablesense_sim.loads import LoadError, normal_force_n
from cablesense_sim.replay import reading_variance_n2

SHOWS_AT_STD = 5.0
"""A change shows when the vector of all readings has changed by this many standard deviations of
one reading, noise and step. Without friction this is five standard deviations of the force."""

DIRECTIONS = 12

_RESTS_ON_THE_WAY = 5
_HALVINGS = 12


class HiddenForce(NamedTuple):
    """Smallest changes of a contact force that show, N, each (N, `DIRECTIONS`).

    Rows are the segments; the directions divide the circle evenly from +z. A change is infinite if
    it does not show up to the size of the load. At the load, forces from `load_n - falling_n` to
    `load_n + rising_n` read the same.

    Attributes:
        touching_n: a first push, on the arm as its commands left it.
        rising_n, falling_n: more, or less, at the load, which has risen from zero.
        released_n: a second push, after the load was applied and removed.
    """

    touching_n: Array
    rising_n: Array
    falling_n: Array
    released_n: Array


def hidden_force(arm: Arm, commands_rad: ArrayLike, load_n: float) -> HiddenForce:
    """The forces that an arm's friction hides at the last of commands (R, 2N).

    The arm starts straight and moves to each command in several rests. Loads up to `load_n` act at
    the contact points, normal to their segment.

    Raises:
        LoadError: `load_n` is no positive number.
        EquilibriumError: a command that the arm cannot take, or it finds no rest under the load.
    """
    if not (np.isfinite(load_n) and load_n > 0.0):
        raise LoadError(f"load_n = {load_n:g}: must be a finite force above 0 N")
    nominal, entries = mechanism_of(arm), entries_of(arm)
    poses = [np.zeros(arm.joint_count)]
    for command in np.atleast_2d(np.asarray(commands_rad, dtype=float)):
        wanted = checked_command(nominal, command)
        poses += list(np.linspace(poses[-1], wanted, _RESTS_ON_THE_WAY + 1)[1:])
    shape = (arm.segment_count, DIRECTIONS)
    segments = np.arange(1, arm.segment_count + 1)[:, None]
    angles_deg = np.broadcast_to(np.arange(DIRECTIONS) * (360.0 / DIRECTIONS), shape)
    pushes = normal_force_n(nominal, poses[-1], segments, angles_deg, 1.0)
    pushes = pushes.reshape(-1, *pushes.shape[-2:])
    from cablesense_sim.quasi_static import QuasiStaticArm  # compiled: others need not wait

    arms = QuasiStaticArm([amended(nominal, entries)] * len(pushes), [entries] * len(pushes))
    actuators = actuations([entries])
    for time_s, pose in enumerate(poses):
        held = held_lengths_m(nominal, pose)[None]
        for actuator in actuators:
            held = actuator.step(time_s, held)
        held = np.repeat(held, len(pushes), axis=0)
        arms.step(time_s, held, 0.0 * pushes)

    def rested_n(at: QuasiStaticArm, force_n: Array | float) -> Array:
        forces = np.broadcast_to(force_n, len(pushes))[:, None, None] * pushes
        return at.step(time_s, held, forces)

    shows_n = SHOWS_AT_STD * np.sqrt(reading_variance_n2(arm.sensors))

    def smallest_n(at_n: float, way: float) -> Array:
        """The smallest change that shows, from the present friction state, under `at_n`."""
        before = rested_n(deepcopy(arms), at_n)

        def shown(change_n: Array) -> Array:
            after = rested_n(deepcopy(arms), at_n + way * change_n)
            return np.asarray(np.linalg.norm(after - before, axis=-1) >= shows_n)

        high = np.full(len(pushes), load_n)
        low, found = np.zeros_like(high), shown(high)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            enough = shown(middle)
            low, high = np.where(enough, low, middle), np.where(enough, middle, high)
        return np.where(found, high, np.inf).reshape(shape)

    touching = smallest_n(0.0, 1.0)
    for share in np.arange(1, _RESTS_ON_THE_WAY + 1) / _RESTS_ON_THE_WAY:
        rested_n(arms, share * load_n)
    rising, falling = smallest_n(load_n, 1.0), smallest_n(load_n, -1.0)
    for share in np.arange(_RESTS_ON_THE_WAY)[::-1] / _RESTS_ON_THE_WAY:
        rested_n(arms, share * load_n)
    return HiddenForce(touching, rising, falling, smallest_n(0.0, 1.0))
