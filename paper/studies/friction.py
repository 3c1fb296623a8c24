"""Fig. 6, section II-E and equation (2): the effect of friction on a cable over a cylinder.

`stepped_tensions_n` steps Fig. 3 (c) in time by MuJoCo under several laws of friction;
`quasi_static_tensions_n` is the same by this project's own effect `capstan_friction`.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_sim.cable_chain import CableChains
from paper.cables import (
    AXIAL_RIGIDITY_N,
    CYLINDER_RADIUS_M,
    LENGTH_M,
    PRETENSION_N,
    STIFFNESS_N_M,
    around_a_cylinder,
    drive_direction,
)
from paper.drawing import BLACK, BLUE, GREY, ORANGE, SERIES, one_panel, panels
from paper.study import Figures, Numbers, Progress

_STICK_STIFFNESS_N_M = 5e8
"""With which friction gives before it slips: fifty times the cable's own."""


class Friction(StrEnum):
    """The friction that holds the piece of cable on the cylinder.

    NONE: nothing. FRICTIONLOSS: MuJoCo's dry friction, a constraint, as it comes; the paper uses
    it. HARDENED: the same, the constraint as hard as MuJoCo takes it. YIELDING: MuJoCo's spring
    that yields at a fixed force (`springyield`). CAPSTAN: that spring, its yield force following
    the tensions by equation (2), set at every step.
    """

    NONE = "none"
    FRICTIONLOSS = "frictionloss"
    HARDENED = "frictionloss, hardened"
    YIELDING = "yielding spring"
    CAPSTAN = "capstan"


def capstan_limit_n(near_n: Any, far_n: Any, friction_rad: float) -> Any:
    """The most by which two tensions with this sum can differ before the cable slips.

    Where T_far = T_near exp(-μ θ), as equation (2) has it, T_near - T_far = (T_near + T_far)
    tanh(μ θ / 2). `friction_rad` is μ θ.
    """
    return (near_n + far_n) * np.tanh(0.5 * friction_rad)


def stepped_tensions_n(
    path_m: Array, friction: Friction, coefficient: float, wrap_rad: float, step_s: float = 1e-3
) -> Array:
    """Tensions (T, 2) before and beyond the cylinder by MuJoCo, along a path (T,) of the drive.

    Each position is a step of time on the model of Fig. 3 (c); tensions are those of its two
    halves. Laws with a fixed force take that which the capstan holds at the pretension.
    """
    fixed_n = float(capstan_limit_n(PRETENSION_N, PRETENSION_N, coefficient * wrap_rad))
    torsion_n_m_rad = _STICK_STIFFNESS_N_M * CYLINDER_RADIUS_M**2
    spec = around_a_cylinder(wrap_rad)
    spec.option.timestep = step_s
    ring = spec.joint("ring")
    if friction in (Friction.FRICTIONLOSS, Friction.HARDENED):
        ring.frictionloss = fixed_n * CYLINDER_RADIUS_M
        if friction is Friction.HARDENED:
            # twice a step of 1 ms, the shortest without `refsafe`; and MuJoCo's bound `mjMAXIMP`
            ring.solref_friction = (2e-3, 1.0)
            ring.solimp_friction = (0.9999, 0.9999, 1e-3, 0.5, 2.0)
    elif friction is not Friction.NONE:
        ring.stiffness = [torsion_n_m_rad, 0.0, 0.0]
        ring.springyield = fixed_n * CYLINDER_RADIUS_M / torsion_n_m_rad
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    drive_m = data.mocap_pos[0] + path_m[:, None] * drive_direction(wrap_rad)
    stiffness_n_m = model.tendon_stiffness.reshape(2, -1)[:, 0]

    def both_n() -> Array:
        mujoco.mj_kinematics(model, data)
        mujoco.mj_tendon(model, data)
        stretch_m = data.ten_length - model.tendon_lengthspring[:, 1]
        return np.asarray(np.maximum(stiffness_n_m * stretch_m, 0.0))

    tensions = np.empty((len(path_m), 2))
    for row, place_m in enumerate(drive_m):
        data.mocap_pos[0] = place_m
        if friction is Friction.CAPSTAN:
            near_n, far_n = both_n()
            limit_n = capstan_limit_n(near_n, far_n, coefficient * wrap_rad)
            model.jnt_springyield[:] = limit_n * CYLINDER_RADIUS_M / torsion_n_m_rad
        mujoco.mj_step(model, data)
        tensions[row] = both_n()
    return tensions


def quasi_static_tensions_n(path_m: Array, coefficient: float, wrap_rad: float) -> Array:
    """Tensions (T, 2) before and beyond the cylinder along a path (T,) of the drive.

    Its halves are the pieces of `cablesense_sim.cable_chain`, as in the effect
    `capstan_friction`. The contact gives as much before it slips as the friction of
    `stepped_tensions_n` does.
    """
    limit = np.array([[coefficient * wrap_rad]])
    half_m_n = 0.5 * LENGTH_M / AXIAL_RIGIDITY_N
    give_m = max(limit[0, 0], 1e-6) * PRETENSION_N / _STICK_STIFFNESS_N_M
    tensioned_m = 2.0 * half_m_n * PRETENSION_N
    cable = CableChains(
        np.array([[half_m_n, half_m_n]]),
        np.array([[tensioned_m, 0.0]]),
        limit,
        0.0 * limit,
        give_m,
    )
    tensions = np.empty((len(path_m), 2))
    for row, drawn_m in enumerate(path_m):
        lengths_m = np.array([[tensioned_m + drawn_m, 0.0]])
        tensions[row] = cable.pull(lengths_m, limit).tensions_n[0]
        cable.settle(lengths_m, limit)
    return tensions


_COEFFICIENT = 0.2
_WRAP_RAD = float(np.pi)
_HIGH_M = 8e-6
_LOW_M = -2e-6
"""The drive's stroke; both halves of the cable stay taut."""

_STEP_S = 1e-3
_FINE_STEP_S = 5e-4
_PULL_S = 1.0
_SETTLE_S = 0.3
_LAWS = tuple(Friction)[1:]


def friction(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """Loops, the sweep of equation (2), and the friction left at rest, on Fig. 3 (c)."""
    rest_s: float = size["rest_s"]
    path = _path_m(size["cycle_s"])
    loops = {}
    for done, law in enumerate(Friction, start=1):
        loops[law] = stepped_tensions_n(path, law, _COEFFICIENT, _WRAP_RAD, _FINE_STEP_S)
        progress(0.05 * done)
    own_n = quasi_static_tensions_n(path, _COEFFICIENT, _WRAP_RAD)
    apart_n = float(np.abs(own_n - loops[Friction.CAPSTAN]).max())
    progress(0.35)
    sweep = np.array(
        [
            (mu, np.pi * half_turns, _slip_ratio(mu, np.pi * half_turns))
            for mu in size["coefficients"]
            for half_turns in size["half_turns"]
        ]
    )
    progress(0.65)
    left_share = {law: _left_of_held(law, rest_s) for law in _LAWS}
    width_n = {law: _loop_width_n(path, loops[law][:, 0]) for law in _LAWS}
    numbers = {
        "mu": _COEFFICIENT,
        "wrap_rad": _WRAP_RAD,
        "rest_s": rest_s,
        "soft_width_n": width_n[Friction.FRICTIONLOSS],
        "hard_width_n": width_n[Friction.HARDENED],
        "laws": [(str(law), width_n[law], 100.0 * left_share[law]) for law in _LAWS],
        "worst": float(np.abs(sweep[:, 2] / np.exp(-sweep[:, 0] * sweep[:, 1]) - 1.0).max()),
        "pairs": len(sweep),
        "slip_ratio": _slip_ratio(_COEFFICIENT, _WRAP_RAD),
        "closed_ratio": float(np.exp(-_COEFFICIENT * _WRAP_RAD)),
        "apart_n": apart_n,
        "loops_agree": "partly" if apart_n < 0.1 * width_n[Friction.CAPSTAN] else "no",
        "capstan_left": left_share[Friction.CAPSTAN],
        "fixed_n": 100.0 * np.tanh(0.5 * _COEFFICIENT * _WRAP_RAD),
    }
    return numbers, {
        "fig_6_hysteresis": _loop_figure(path, loops, own_n),
        "equation_2_capstan": _sweep_figure(sweep),
    }


def _path_m(cycle_s: float) -> Array:
    """To the high end, and then one closed cycle of the drive; begins and ends at standstill."""
    time_s = np.arange(0.0, 1.5 * cycle_s, _FINE_STEP_S)
    phase = 2.0 * np.pi * time_s / cycle_s
    up = 0.5 * _HIGH_M * (1.0 - np.cos(phase))
    mean = 0.5 * (_HIGH_M + _LOW_M)
    half = 0.5 * (_HIGH_M - _LOW_M)
    return np.where(time_s < 0.5 * cycle_s, up, mean - half * np.cos(phase))


def _slip_ratio(coefficient: float, wrap_rad: float) -> float:
    """T_out / T_in after a pull that has made the cable slip, at rest."""
    slips_at_m = PRETENSION_N * np.expm1(coefficient * wrap_rad) / (2.0 * STIFFNESS_N_M)
    time_s = np.arange(0.0, _PULL_S + _SETTLE_S, _STEP_S)
    path = 5.0 * slips_at_m * np.clip(time_s / _PULL_S, 0.0, 1.0)
    near_n, far_n = stepped_tensions_n(path, Friction.CAPSTAN, coefficient, wrap_rad)[-1]
    return float(far_n / near_n)


def _left_of_held(law: Friction, rest_s: float) -> float:
    """T1 - T2 after a time with the drive at rest, by that at the end of the pull into slip."""
    pull = _HIGH_M * np.clip(np.arange(0.0, _PULL_S, _STEP_S) / _PULL_S, 0.0, 1.0)
    still = np.full(round((_SETTLE_S + rest_s) / _STEP_S), _HIGH_M)
    tensions = stepped_tensions_n(np.concatenate([pull, still]), law, _COEFFICIENT, _WRAP_RAD)
    # a spring that yields lags by a step, which is over at once when the drive stops
    settled = len(pull) + (round(_SETTLE_S / _STEP_S) if "frictionloss" not in law else 0)
    held_n = tensions[settled:, 0] - tensions[settled:, 1]
    return float(held_n[-1] / held_n[0])


def _loop_width_n(path_m: Array, tension_n: Array) -> float:
    """Drawing less letting out, where that is most, in the closed cycle."""
    third = len(path_m) // 3
    out = slice(third, 2 * third)
    back = slice(2 * third, None)
    at_m = np.linspace(_LOW_M, _HIGH_M, 400)
    letting = np.interp(-at_m, -path_m[out], tension_n[out])
    drawing = np.interp(at_m, path_m[back], tension_n[back])
    return float((drawing - letting).max())


def _loop_figure(path_m: Array, loops: dict[Friction, Array], own_n: Array) -> Any:
    figure, grid_axes = panels(1, 4, 3.5, sharex=True, sharey=True)
    cycle = slice(len(path_m) // 3, None)
    path_um = 1e6 * path_m
    free_n = loops[Friction.NONE][cycle, 0]
    for axes, law in zip(grid_axes[0], _LAWS, strict=True):
        near_n, far_n = loops[law].T
        axes.plot(path_um[cycle], free_n, color=GREY, ls="--", lw=1.2, label="no friction")
        axes.plot(path_um, near_n, color=BLUE, lw=1.8, label="at the drive, T1")
        axes.plot(path_um, far_n, color=ORANGE, ls="-.", lw=1.8, label="beyond the cylinder, T2")
        axes.set(title=law, xlabel="drive position, µm")
    axes.plot(
        path_um,
        own_n[:, 0],
        color=BLACK,
        ls=":",
        lw=1.4,
        label="T1 by the effect capstan_friction",
    )
    grid_axes[0, 0].set(ylabel="tension, N", ylim=(0.0, None))
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=4)
    return figure


def _sweep_figure(sweep: Array) -> Any:
    figure, axes = one_panel(3.6, width=0.62)
    product = np.linspace(0.0, 1.05 * float((sweep[:, 0] * sweep[:, 1]).max()), 200)
    axes.plot(product, np.exp(-product), color=BLACK, lw=1.2, label="equation (2), exp(−μθ)")
    for n, mu in enumerate(np.unique(sweep[:, 0])):
        _, wrap_rad, ratio = sweep[sweep[:, 0] == mu].T
        axes.plot(
            mu * wrap_rad,
            ratio,
            "os^vDP"[n],
            color=SERIES[n],
            ms=6,
            ls="none",
            label=f"MuJoCo, μ = {mu:g}",
        )
    axes.set(xlabel="μ θ", ylabel="T_out / T_in in slip", ylim=(0.0, 1.03), xlim=(0.0, None))
    axes.legend()
    return figure
