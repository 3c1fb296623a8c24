"""What an arm can be commanded to, and the cable lengths that its actuators then hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_sim import kinematics
from cablesense_sim.effects.actuation import Actuation
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]


def checked_command(mechanism: Mechanism, joint_angles_rad: ArrayLike) -> Array:
    """Joint angles (2N,) as an array.

    Raises:
        EquilibriumError: wrong shape, not finite, or a bend at which guide plates would touch.
    """
    command = np.asarray(joint_angles_rad, dtype=float)
    if command.shape != (mechanism.joint_count,) or not np.isfinite(command).all():
        raise EquilibriumError(
            f"a command is {mechanism.joint_count} finite joint angles in rad, not {command!r}"
        )
    bend, limit = kinematics.bend_rad(command), mechanism.bend_limit_rad
    if (bend >= limit).any():
        joint = int(np.argmax(bend - limit))
        raise EquilibriumError(
            f"commanded bend of joint {joint + 1} is {np.rad2deg(bend[joint]):.1f} degrees; "
            f"its guide plates touch at {np.rad2deg(limit[joint]):.1f}"
        )
    return command.copy()


def actuated_m(
    nominal: Mechanism, command_rad: Array, through: Sequence[Actuation], time_s: float
) -> Array:
    """Lengths (M,), relative to the straight arm, that actuators hold under a command (2N,).

    They are commanded those of the `nominal` arm: its controller knows of no effects.
    """
    held = held_lengths_m(nominal, command_rad)[None]
    for actuation in through:
        held = actuation.step(time_s, held)
    return np.asarray(held[0])
