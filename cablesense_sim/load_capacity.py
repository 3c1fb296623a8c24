"""The loads that an arm bears, and those that its friction hides.

The arm supports a load if the straight arm has an equilibrium under it from every side, with no
guide plates touching and no sensor at the end of its range.

While a cable sticks at its first guide its run keeps its tension, and the sensor at the actuator
reads no change. The change of force that readings show depends on pose and history. It is found by
simulation: the arm rests under one force, then under another, each time from the same friction
state (`cablesense_sim.quasi_static`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base import Array, CableSenseError
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import actuations, amended, joint_zeros_rad
from cablesense_sim.equilibrium import (
    EquilibriumError,
    checked_command,
    held_lengths_m,
    solve_equilibrium,
)
from cablesense_sim.kinematics import bend_rad, contact_points_m
from cablesense_sim.loads import LoadError, normal_force_n
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.replay import reading_variance_n2

if TYPE_CHECKING:
    from cablesense_sim.quasi_static import QuasiStaticArm

USUAL_CONTACT_N = 200.0
"""The strongest contact that networks learn unless the arm bears less: a person's firm push."""

_POSES = 500
"""Random poses that judge a range."""
_FAILING_SHARE = 0.01
"""Share of them that may find no equilibrium."""

SEARCHED_UP_TO_N = 2000.0
"""The search ends at this force."""

_WORKING_SHARE = 2.0 / 3.0  # share of the load of the straight arm: a bent one bears less

_MOST_SAG = 1.0 / 3.0
"""Share of the bend at which guide plates touch that the weight of an arm may take: beyond it, a
small error of its build moves the arm far."""

DIRECTIONS = 12
"""From which forces come: they divide the circle evenly from +z."""
_SIDES = 4  # groups of directions that are looked at one after another

_AS_USUAL = 0.999
"""Share of the usual contact from which on an arm bears it: bisections end a little below."""
_LEAST_RANGE_SHARE = 0.1
"""Share of the usual range of poses below which no smaller one is tried."""
_RANGE_STEP_SHARE = 0.05
"""Share of the usual range by which it is made smaller."""
_WEAKEST_CONTACT_N = 1e-3
"""The weakest contact that is tried: an arm that bears less bears none."""
_HALVINGS = 6  # bisections between a supported force and twice that force; a hundredth remains

SHOWS_AT_STD = 5.0
"""A change shows when the vector of all readings has changed by this many standard deviations of
one reading, noise and step. Without friction this is five standard deviations of the force."""
_RESTS_ON_THE_WAY = 5
"""Equilibria between two poses, or to a load: history-dependent effects take the whole path."""
_HALVINGS_OF_HIDDEN = 12
"""Bisections of the smallest change that shows: to 1 / 4096 of the load."""


class WeakArmError(CableSenseError):
    """An arm that cannot stand, or bears no contact: names the arm, and what would help."""


class LoadCapacity(NamedTuple):
    """The greatest loads of the straight arm.

    Attributes:
        sag_deg: the largest turn of a joint under the arm's own weight.
        sag_m: how far the last segment's contact point moves by it.
        greatest_n: (N,) greatest force that each segment bears at its contact point from every
            side, N; `SEARCHED_UP_TO_N` means that or more.
    """

    sag_deg: float
    sag_m: float
    greatest_n: Array


def load_capacity(arm: Arm) -> LoadCapacity:
    """Sag and greatest loads of an arm with the effects of its file.

    Raises:
        WeakArmError: it finds no equilibrium under its own weight, or bears no contact of a
            millinewton.
    """
    mechanism = amended(mechanism_of(arm), entries_of(arm))
    straight = np.zeros(arm.joint_count)
    angles = _unloaded_rad(arm, mechanism)
    moved_m = contact_points_m(mechanism, angles) - contact_points_m(mechanism, straight)
    return LoadCapacity(
        sag_deg=float(np.rad2deg(np.abs(angles).max())),
        sag_m=float(np.linalg.norm(moved_m[-1])),
        greatest_n=_greatest_n(arm, mechanism, SEARCHED_UP_TO_N),
    )


def contact_range_n(arm: Arm, usual_n: float = USUAL_CONTACT_N, contacts: int = 1) -> float:
    """The strongest contact to draw on an arm, N: `usual_n`, or less where it bears less.

    Two digits of two thirds of what its weakest segment bears, divided among `contacts`.

    Raises:
        WeakArmError: as `load_capacity`.
    """
    mechanism = amended(mechanism_of(arm), entries_of(arm))
    _unloaded_rad(arm, mechanism)
    enough_n = usual_n * contacts / _WORKING_SHARE
    bearable_n = _WORKING_SHARE * float(_greatest_n(arm, mechanism, enough_n).min()) / contacts
    if bearable_n > _AS_USUAL * usual_n:
        return usual_n
    step_n = 10.0 ** (np.floor(np.log10(bearable_n)) - 1.0)
    return round(float(np.floor(bearable_n / step_n) * step_n), 9)


def pose_range_deg(arm: Arm, usual_deg: float, force_n: float) -> float:
    """How far to command the joints of an arm at random, ± degrees: `usual_deg`, or less.

    Less where its own weight, or contacts of up to `force_n`, bend it too far in more than one of
    a hundred poses. Not below a tenth of the usual range.
    """
    mechanism = amended(mechanism_of(arm), entries_of(arm))
    rng = np.random.default_rng(0)
    shares = rng.uniform(-1.0, 1.0, (_POSES, arm.joint_count))
    segments = rng.integers(1, arm.segment_count + 1, _POSES)
    angles_deg = rng.uniform(0.0, 360.0, _POSES)
    magnitudes_n = rng.uniform(0.0, force_n, _POSES)
    range_deg = usual_deg
    while range_deg > _LEAST_RANGE_SHARE * usual_deg:
        command = np.deg2rad(range_deg) * shares
        forces = normal_force_n(mechanism, command, segments, angles_deg, magnitudes_n)
        try:
            solve_equilibrium(mechanism, command, forces)
        except EquilibriumError as error:
            if len(error.failed) > _FAILING_SHARE * _POSES:
                range_deg = round(range_deg - _RANGE_STEP_SHARE * usual_deg, 9)
                continue
        break
    return range_deg


def _unloaded_rad(arm: Arm, mechanism: Mechanism) -> Array:
    limit_rad = float(mechanism.bend_limit_rad.min())
    try:
        angles_rad = solve_equilibrium(mechanism, np.zeros(arm.joint_count)).joint_angles_rad
        sag_rad = float(bend_rad(angles_rad).max())
    except EquilibriumError:
        sag_rad = limit_rad
    if sag_rad <= _MOST_SAG * limit_rad:
        return angles_rad
    raise WeakArmError(
        f"arm {arm.name} cannot stand: straight and without a load, its own weight bends a joint "
        f"by {np.rad2deg(sag_rad):.0f} degrees or more, and guide plates touch at "
        f"{np.rad2deg(limit_rad):.0f}; lower segments.mass_kg, or raise cables.pretension_n, the "
        "cables' stiffness or cables.routing_radius_m"
    )


def _greatest_n(arm: Arm, mechanism: Mechanism, most_n: float) -> Array:
    """(N,) at most `most_n`, all segments side by side, by doubling and then halving."""
    segments = np.arange(1, arm.segment_count + 1)[:, None]
    angles_deg = np.arange(DIRECTIONS) * (360.0 / DIRECTIONS)
    unit = normal_force_n(mechanism, np.zeros(arm.joint_count), segments, angles_deg, 1.0)
    highest_n = np.inf if arm.sensors.range_n is None else arm.sensors.range_n[1]

    def borne(size_n: Array, which: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whether (N,) segments, of those in `which`, bear a force from every side."""
        bearing = which.copy()
        for side in range(_SIDES):  # a force that is not borne costs a hundred that are
            forces = size_n[:, None, None, None] * unit[:, side::_SIDES]
            bearing[bearing] = rests(forces[bearing]).all(axis=1)
        return bearing

    def rests(forces: Array) -> NDArray[np.bool_]:
        command = np.zeros((*forces.shape[:2], arm.joint_count))
        at_rest = np.ones(forces.shape[:2], dtype=bool)
        try:
            tensions = solve_equilibrium(mechanism, command, forces).tensions_n
        except EquilibriumError as error:
            at_rest.flat[error.failed] = False
            tensions = solve_equilibrium(mechanism, command[at_rest], forces[at_rest]).tensions_n
        at_rest[at_rest] = (tensions < highest_n).all(axis=-1).ravel()
        return at_rest

    high = np.full(arm.segment_count, most_n)
    weak = ~borne(high, high > 0.0)
    low = np.where(weak, _WEAKEST_CONTACT_N, most_n)
    if not borne(low, weak)[weak].all():
        raise WeakArmError(
            f"arm {arm.name} bears no contact of {1e3 * _WEAKEST_CONTACT_N:g} mN on a segment "
            "before guide plates touch or a sensor is at the end of sensors.range_n; raise the "
            "cables' stiffness, cables.pretension_n or the range"
        )
    growing = weak.copy()
    while growing.any():
        high[growing] = np.minimum(2.0 * low[growing], most_n)
        growing &= borne(high, growing)
        low[growing] = high[growing]
    for _ in range(_HALVINGS):
        middle = np.sqrt(low * high)
        enough = borne(middle, weak)
        low = np.where(enough, middle, low)
        high = np.where(weak & ~enough, middle, high)
    return low


class HiddenForce(NamedTuple):
    """Smallest changes of a contact force that show, N, each (N, `DIRECTIONS`), by segment.

    A change is infinite if it does not show up to the size of the load. At the load, forces from
    `load_n - falling_n` to `load_n + rising_n` read the same.

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
        EquilibriumError: a command that the arm cannot take, or it finds no equilibrium under the
            load.
    """
    if not (np.isfinite(load_n) and load_n > 0.0):
        raise LoadError(f"load_n = {load_n:g}: must be a finite force above 0 N")
    nominal = mechanism_of(arm)
    entries = entries_of(arm)
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
    zeros_rad = joint_zeros_rad([entries], arm.segment_count)
    for time_s, pose in enumerate(poses):
        held = held_lengths_m(nominal, pose if zeros_rad is None else pose + zeros_rad[0])[None]
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
        before = rested_n(arms.branched(), at_n)

        def shown(change_n: Array) -> Array:
            after = rested_n(arms.branched(), at_n + way * change_n)
            return np.asarray(np.linalg.norm(after - before, axis=-1) >= shows_n)

        high = np.full(len(pushes), load_n)
        low = np.zeros_like(high)
        visible = shown(high)
        for _ in range(_HALVINGS_OF_HIDDEN):
            middle = 0.5 * (low + high)
            enough = shown(middle)
            low = np.where(enough, low, middle)
            high = np.where(enough, middle, high)
        return np.where(visible, high, np.inf).reshape(shape)

    touching = smallest_n(0.0, 1.0)
    for share in np.arange(1, _RESTS_ON_THE_WAY + 1) / _RESTS_ON_THE_WAY:
        rested_n(arms, share * load_n)
    rising = smallest_n(load_n, 1.0)
    falling = smallest_n(load_n, -1.0)
    for share in np.arange(_RESTS_ON_THE_WAY)[::-1] / _RESTS_ON_THE_WAY:
        rested_n(arms, share * load_n)
    return HiddenForce(touching, rising, falling, smallest_n(0.0, 1.0))
