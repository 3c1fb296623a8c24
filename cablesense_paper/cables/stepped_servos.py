"""The cable driven at both ends, Fig. 3 (b), in MuJoCo: brought to rest, or to burst."""

from __future__ import annotations

from copy import copy
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_paper.cables.one_metre_cable import STIFFNESS_N_M, driven_at_both_ends
from cablesense_paper.cables.servo_cable import longest_step_s
from cablesense_sim.model import ACTUATOR_MASS_KG

Array = NDArray[np.float64]

INTEGRATORS = {
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "discrete": mujoco.mjtIntegrator.mjINT_DISCRETE,
}
"""Those of MuJoCo 4.0 that take one step at a time, by its manual's names."""

_PUSHED_M = 1e-7
_STEPS = 400


def critical_kv_n_s_m(kp_n_m: float) -> float:
    """Damping at which a servo alone does not swing, as in this project's arms."""
    return float(2.0 * np.sqrt(kp_n_m * ACTUATOR_MASS_KG))


def positions_at_rest_m(kp_n_m: float, commands_m: Array) -> Array:
    """Where both servos come to rest (C, 2) under commands (C, 2)."""
    data = mujoco.MjData(model := _model(kp_n_m))
    positions = np.empty_like(commands_m)
    for row, command in enumerate(commands_m):
        data.ctrl[:] = command
        # what is left of a step shrinks by 1 + h kp / kv every time, slowest where kp is small
        mujoco.mj_step(model, data, nstep=200)
        positions[row] = data.qpos
    return positions


def stays_bounded(kp_n_m: float, timestep_s: float, integrator: str) -> bool:
    """Whether a small push dies out, or at least does not grow, within 400 steps."""
    model = _model(kp_n_m)
    model.opt.timestep, model.opt.integrator = timestep_s, INTEGRATORS[integrator]
    model.tendon_lengthspring[:] = 1.0  # no pretension: rest is at zero
    data = mujoco.MjData(model)
    data.qpos[:] = _PUSHED_M, 0.3 * _PUSHED_M
    for _ in range(_STEPS):  # one by one: MuJoCo warns on the terminal of numbers that overflow
        mujoco.mj_step(model, data)
        if np.abs(data.qpos).max() > 3.0 * _PUSHED_M:
            return False
    return True


def longest_bounded_step_s(kp_n_m: Any, integrator: str) -> Any:
    """By closed form, for both ways in which the two servos swing: apart, or along together."""
    kp = np.asarray(kp_n_m, dtype=float)
    steps = []
    for cable in (2.0 * STIFFNESS_N_M, 0.0):
        omega = np.sqrt((kp + cable) / ACTUATOR_MASS_KG)
        zeta = 2.0 * np.sqrt(kp * ACTUATOR_MASS_KG) / (2.0 * ACTUATOR_MASS_KG * omega)
        steps.append(longest_step_s(omega, zeta, integrator))
    return np.minimum(*steps)


def _model(kp_n_m: float) -> Any:
    """With `discrete` at 1 ms; to compile anew costs more than to step."""
    return copy(_compiled(kp_n_m))


@lru_cache(maxsize=128)
def _compiled(kp_n_m: float) -> Any:
    return driven_at_both_ends(kp_n_m, critical_kv_n_s_m(kp_n_m)).compile()
