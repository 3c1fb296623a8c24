"""What an arm bears: how far it sags under its own weight, the greatest contact on each segment.

The arm supports a load if the straight arm has an equilibrium under it from every side, with no
guide plates touching and no sensor at the end of its range.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.kinematics import contact_points_m
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism

USUAL_CONTACT_N = 200.0
"""The strongest contact that networks learn unless the arm bears less: a person's firm push."""

SEARCHED_UP_TO_N = 2000.0
"""The search ends at this force."""

_WORKING_SHARE = 2.0 / 3.0
"""Of what the straight arm bears: a bent one bears less."""

_DIRECTIONS = 12
_SIDES = 4
"""Groups of directions that are looked at one after another."""

_LEAST_N = 1e-3
_HALVINGS = 6
"""Fraction of the ratio of 2 between a supported force and one that is not: a hundredth is
left."""


class WeakArmError(CableSenseError):
    """An arm that cannot stand, or bears no contact: names the arm, and what would help."""


class LoadCapacity(NamedTuple):
    """What the straight arm bears.

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
        WeakArmError: it finds no rest under its own weight, or bears no contact of a millinewton.
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
    if bearable_n > 0.999 * usual_n:
        return usual_n
    step_n = 10.0 ** (np.floor(np.log10(bearable_n)) - 1.0)
    return round(float(np.floor(bearable_n / step_n) * step_n), 9)


def _unloaded_rad(arm: Arm, mechanism: Mechanism) -> Array:
    try:
        return solve_equilibrium(mechanism, np.zeros(arm.joint_count)).joint_angles_rad
    except EquilibriumError as error:
        raise WeakArmError(
            f"arm {arm.name} cannot stand: straight and without a load, its own weight bends it "
            "until guide plates touch; lower segments.mass_kg, or raise cables.pretension_n, the "
            "cables' stiffness or cables.routing_radius_m"
        ) from error


def _greatest_n(arm: Arm, mechanism: Mechanism, most_n: float) -> Array:
    """(N,) at most `most_n`, all segments side by side, by doubling and then halving."""
    segments = np.arange(1, arm.segment_count + 1)[:, None]
    angles_deg = np.arange(_DIRECTIONS) * (360.0 / _DIRECTIONS)
    unit = normal_force_n(mechanism, np.zeros(arm.joint_count), segments, angles_deg, 1.0)
    highest_n = np.inf if arm.sensors.range_n is None else arm.sensors.range_n[1]

    def borne(size_n: Array, which: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whether (N,) segments, of those in `which`, bear a force from every side."""
        found = which.copy()
        for side in range(_SIDES):  # a force that is not borne costs a hundred that are
            forces = size_n[:, None, None, None] * unit[:, side::_SIDES]
            found[found] = rests(forces[found]).all(axis=1)
        return found

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
    low = np.where(weak, _LEAST_N, most_n)
    if not borne(low, weak)[weak].all():
        raise WeakArmError(
            f"arm {arm.name} bears no contact of {1e3 * _LEAST_N:g} mN on a segment before guide "
            "plates touch or a sensor is at the end of sensors.range_n; raise the cables' "
            "stiffness, cables.pretension_n or the range"
        )
    growing = weak.copy()
    while growing.any():
        high[growing] = np.minimum(2.0 * low[growing], most_n)
        growing &= borne(high, growing)
        low[growing] = high[growing]
    for _ in range(_HALVINGS):
        middle = np.sqrt(low * high)
        enough = borne(middle, weak)
        low, high = np.where(enough, middle, low), np.where(weak & ~enough, middle, high)
    return low
