"""A cable between servos: where it comes to rest, how it starts, which time steps are stable.

A servo holds a mass m at its command by a force kp (command - position) - kv speed; a cable of
stiffness k pulls at it. First the closed forms, then the same cable in MuJoCo: Fig. 3 (b), driven
at both ends.
"""

from __future__ import annotations

from copy import copy
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_sim.model import ACTUATOR_MASS_KG
from paper.cables import STIFFNESS_N_M, driven_at_both_ends


def tension_at_rest_n(unyielding_n: Any, stiffness_n_m: float, kp_n_m: Any, servos: int) -> Any:
    """Tension where `servos` servos have given way: T = T∞ / (1 + n k / kp).

    `unyielding_n` is T∞, the tension that the same commands and spring length would make between
    ends that do not give. Each servo rests short of its command by T / kp, and the cable is
    shorter by all. Of 1 m of command T∞ = k, and T is the stiffness of cable and servos in series.
    """
    return unyielding_n / (1.0 + servos * stiffness_n_m / np.asarray(kp_n_m))


def starting_force_n(
    time_s: Array, pretension_n: float, stiffness_n_m: float, servo: tuple[float, float, float]
) -> Array:
    """Force of one servo (T,) after a start at its command, with the cable tensioned at once.

    With `servo` = (kp, kv, m): m q'' = -kp q - kv q' - T0 - k q from standstill at q = 0. The
    servo begins with no force and swings about T0 kp / (k + kp) up to nearly twice that.
    """
    kp, kv, mass = servo
    omega = np.sqrt((kp + stiffness_n_m) / mass)
    zeta = kv / (2.0 * mass * omega)
    damped = omega * np.sqrt(1.0 - zeta**2)
    decay = np.exp(-zeta * omega * time_s)
    swing = np.cos(damped * time_s) + zeta * omega / damped * np.sin(damped * time_s)
    rest_m = -pretension_n / (stiffness_n_m + kp)
    position = rest_m * (1.0 - decay * swing)
    speed = rest_m * decay * omega**2 / damped * np.sin(damped * time_s)
    return np.asarray(-kp * position - kv * speed)


def longest_step_s(omega_rad_s: Any, zeta: Any, integrator: str) -> Any:
    """Longest stable time step for m q'' = -k q - c q', ω² = k / m, ζ = c / (2 m ω).

    All four take the new speed for the new position. `Euler` takes spring and damper as they are
    at the start of a step: ω h < 2 (sqrt(1 + ζ²) - ζ). `implicit` and `implicitfast` take the
    damper, not the spring, at its end: ω h < 2 (sqrt(1 + ζ²) + ζ). `discrete` takes both at its
    end: no limit. Each is Jury's criterion on the two roots of a step.
    """
    if integrator == "discrete":
        return np.full(np.broadcast(omega_rad_s, zeta).shape, np.inf)
    sign = -1.0 if integrator == "Euler" else 1.0
    return 2.0 * (np.sqrt(1.0 + np.square(zeta)) + sign * zeta) / omega_rad_s


INTEGRATORS = {
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "discrete": mujoco.mjtIntegrator.mjINT_DISCRETE,
}
"""Those of MuJoCo 4.0 that take one step at a time, by its manual's names."""


def positions_at_rest_m(kp_n_m: float, commands_m: Array) -> Array:
    """The positions (C, 2) of both servos at rest under commands (C, 2)."""
    model = _compiled(kp_n_m)
    data = mujoco.MjData(model)
    positions = np.empty_like(commands_m)
    for row, command in enumerate(commands_m):
        data.ctrl[:] = command
        # what is left of a step shrinks by 1 + h kp / kv every time, slowest where kp is small
        mujoco.mj_step(model, data, nstep=200)
        positions[row] = data.qpos
    return positions


def stays_bounded(kp_n_m: float, timestep_s: float, integrator: str) -> bool:
    """Whether a small push dies out, or at least does not grow, within 400 steps."""
    model = copy(_compiled(kp_n_m))  # to compile anew costs more than to step
    model.opt.timestep = timestep_s
    model.opt.integrator = INTEGRATORS[integrator]
    model.tendon_lengthspring[:] = 1.0  # no pretension: rest is at zero
    data = mujoco.MjData(model)
    data.qpos[:] = 1e-7, 0.3e-7
    for _ in range(400):  # one by one: MuJoCo warns on the terminal of numbers that overflow
        mujoco.mj_step(model, data)
        if np.abs(data.qpos).max() > 3e-7:
            return False
    return True


def longest_bounded_step_s(kp_n_m: Any, integrator: str) -> Any:
    """By closed form, for both modes of the two servos: apart, or along together."""
    kp = np.asarray(kp_n_m, dtype=float)
    steps = []
    for cable in (2.0 * STIFFNESS_N_M, 0.0):
        omega = np.sqrt((kp + cable) / ACTUATOR_MASS_KG)
        zeta = 2.0 * np.sqrt(kp * ACTUATOR_MASS_KG) / (2.0 * ACTUATOR_MASS_KG * omega)
        steps.append(longest_step_s(omega, zeta, integrator))
    return np.minimum(*steps)


@lru_cache(maxsize=128)
def _compiled(kp_n_m: float) -> Any:
    """Critically damped: a servo alone does not swing, as in this project's arms."""
    kv_n_s_m = float(2.0 * np.sqrt(kp_n_m * ACTUATOR_MASS_KG))
    return driven_at_both_ends(kp_n_m, kv_n_s_m).compile()
