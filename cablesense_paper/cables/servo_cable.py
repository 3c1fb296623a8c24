"""A cable between servos in closed form: where it rests, how it starts, which steps are stable.

A servo holds a mass m where it is told by a force kp (command - position) - kv speed; a cable of
stiffness k pulls at it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def tension_at_rest_n(unyielding_n: Any, stiffness_n_m: float, kp_n_m: Any, servos: int) -> Any:
    """Tension where `servos` servos have given way: T = T∞ / (1 + n k / kp).

    `unyielding_n` is T∞, the tension that the same commands and spring length would make between
    ends that do not give. Each servo stands back by T / kp, and the cable is shorter by all.
    """
    return unyielding_n / (1.0 + servos * stiffness_n_m / np.asarray(kp_n_m))


def steady_error_m(unyielding_n: Any, stiffness_n_m: float, kp_n_m: Any, servos: int) -> Any:
    """How far each servo rests short of its command: e = T / kp."""
    return tension_at_rest_n(unyielding_n, stiffness_n_m, kp_n_m, servos) / np.asarray(kp_n_m)


def series_stiffness_n_m(stiffness_n_m: float, kp_n_m: Any, servos: int) -> Any:
    """Stiffness from a command to the tension, cable and servos in series."""
    return tension_at_rest_n(stiffness_n_m, stiffness_n_m, kp_n_m, servos)


def starting_force_n(
    time_s: Array, pretension_n: float, stiffness_n_m: float, servo: tuple[float, float, float]
) -> Array:
    """Force of one servo (T,) after a start at its command, with the cable tensioned at once.

    With `servo` = (kp, kv, m): m q'' = -kp q - kv q' - T0 - k q from rest at q = 0. The servo
    begins with no force and swings about T0 kp / (k + kp) up to nearly twice that.
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
