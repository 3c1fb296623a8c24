"""Fig. 4 and 5, sections II-B to II-D: a cable 1 m long, tensioned and drawn by servos.

How stiff a servo must be, and which time steps bear that.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.stats import linregress

from cablesense_base import Array
from cablesense_gap.report.style import FLOOR
from cablesense_sim.model import ACTUATOR_MASS_KG
from paper.cables import PRETENSION_N, STIFFNESS_N_M, fixed_and_driven
from paper.drawing import BLACK, BLUE, DASHES, ORANGE, SERIES, one_panel, panels
from paper.servo_cable import (
    INTEGRATORS,
    longest_bounded_step_s,
    positions_at_rest_m,
    starting_force_n,
    stays_bounded,
    tension_at_rest_n,
)
from paper.study import Figures, Numbers, Progress

_PULL_M = 10e-6
_PERIOD_S = 1.0
"""As the paper is silent on its drive signal: twice the pretension's stretch, out and back."""
_KP_N_M = 10.0 * STIFFNESS_N_M
"""An order of magnitude above the cable, section II-D."""
_DAMPING_RATIO = 0.03
"""Of the start; low, so that it swings as the paper's does."""
_START_S = 4e-3
_START_STEP_S = 1e-6
_STEP_S = 1e-3
_NOISE_N = 0.05
"""Of the arm's sensors: what gives the fitted slope an error."""


def pretension(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """The start in fine steps, then a drive signal out and back, on the model of Fig. 3 (a)."""
    omega = np.sqrt((_KP_N_M + STIFFNESS_N_M) / ACTUATOR_MASS_KG)
    kv = 2.0 * _DAMPING_RATIO * ACTUATOR_MASS_KG * omega
    start_s, servo_n, cable_n = _started(kv)
    progress(0.5)
    model, data = _model(_KP_N_M, kv)
    rest_n = _tension_at_rest_n(model, data, steps=1000)
    time_s = _STEP_S * np.arange(float(round(size["periods"] * _PERIOD_S / _STEP_S)))
    command_m = 0.5 * _PULL_M * (1.0 - np.cos(2.0 * np.pi * time_s / _PERIOD_S))
    position_m = np.empty_like(time_s)
    tension_n = np.empty_like(time_s)
    for row, drawn in enumerate(command_m):
        data.ctrl[0] = drawn
        tension_n[row] = _tension_at_rest_n(model, data, steps=1)
        position_m[row] = data.qpos[0]
    progress(0.8)
    noise_n = np.random.default_rng(4).normal(0.0, _NOISE_N, len(tension_n))
    by_position = linregress(position_m, tension_n + noise_n)
    by_command = linregress(command_m, tension_n + noise_n)
    series_n_m = float(tension_at_rest_n(STIFFNESS_N_M, STIFFNESS_N_M, _KP_N_M, 1))
    servo = (_KP_N_M, kv, ACTUATOR_MASS_KG)
    closed_n = starting_force_n(start_s, PRETENSION_N, STIFFNESS_N_M, servo)
    numbers = {
        "start_n": float(cable_n[0]),
        "rest_n": rest_n,
        "closed_rest_n": float(tension_at_rest_n(PRETENSION_N, STIFFNESS_N_M, _KP_N_M, 1)),
        "by_position": _plus_minus(by_position),
        "by_command": _plus_minus(by_command),
        "position_agrees": _is_slope(by_position, STIFFNESS_N_M),
        "command_agrees": _is_slope(by_command, series_n_m),
        "series": series_n_m / 1e7,
        "lowest_n": float(servo_n.min()),
        "highest_n": float(servo_n.max()),
        "cable_low_n": cable_n.min(),
        "off_n": float(np.abs(servo_n - closed_n).max()),
        "drawn_um": 1e6 * _PULL_M,
        "rows": [_both_ways_to_the_pretension(times) for times in (1.0, 10.0, 100.0)],
    }
    figure, ((a, b, c),) = panels(1, 3, 3.3)
    a.plot(time_s, 1e6 * command_m, color=BLACK)
    a.set(title="(a)", xlabel="time, s", ylabel="actuator position (drive signal), µm")
    b.plot(start_s, servo_n, color=ORANGE, lw=1.0, label="start, at the actuator")
    b.plot(time_s, tension_n, color=BLUE, label="cable tension")
    b.set(title="(b)", xlabel="time, s", ylabel="tension, N", ylim=(0.0, None))
    b.legend(loc="lower center")
    c.plot(np.zeros(2), [servo_n.min(), servo_n.max()], color=ORANGE, lw=1.6)
    c.plot(1e6 * position_m, tension_n, color=BLUE)
    ends = np.array([position_m.min(), position_m.max()])
    fitted_n = by_position.intercept + by_position.slope * ends
    label = "fit"
    c.plot(1e6 * ends, fitted_n, color=BLACK, ls=":", lw=2.0, label=label)
    c.set(title="(c)", xlabel="actuator position, µm", ylabel="tension, N", ylim=(0.0, None))
    c.legend(loc="lower right")
    return numbers, {"fig_4_pretension": figure}


def _started(kv: float) -> tuple[Array, Array, Array]:
    """Times (T,) after the start at a command of zero, forces of servo and cable."""
    model, data = _model(_KP_N_M, kv)
    model.opt.timestep = _START_STEP_S
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    count = round(_START_S / _START_STEP_S)
    servo_n = np.empty(count)
    cable_n = np.empty(count)
    for row in range(count):
        mujoco.mj_forward(model, data)
        servo_n[row] = data.actuator_force[0]
        cable_n[row] = _tension_n(model, data)
        mujoco.mj_step(model, data)
    return _START_STEP_S * np.arange(float(count)), servo_n, cable_n


def _both_ways_to_the_pretension(times: float) -> tuple[str | float, ...]:
    """Tension at rest by spring length, by control signal, and by closed form, for kp in k."""
    kp = times * STIFFNESS_N_M
    tensions_n = []
    for bias_m in (None, PRETENSION_N / STIFFNESS_N_M):
        model, data = _model(kp, 2.0 * np.sqrt(kp), bias_m)
        data.ctrl[0] = bias_m or 0.0
        tensions_n.append(_tension_at_rest_n(model, data, steps=2000))
    closed_n = float(tension_at_rest_n(PRETENSION_N, STIFFNESS_N_M, kp, 1))
    return f"{times:.0f} k", *tensions_n, closed_n


def _model(kp: float, kv: float, bias_m: float | None = None) -> Any:
    model = fixed_and_driven(kp, kv, bias_m).compile()
    return model, mujoco.MjData(model)


def _tension_at_rest_n(model: Any, data: Any, steps: int) -> float:
    mujoco.mj_step(model, data, nstep=steps)
    mujoco.mj_forward(model, data)
    return _tension_n(model, data)


def _tension_n(model: Any, data: Any) -> float:
    return float(STIFFNESS_N_M * (data.ten_length[0] - model.tendon_lengthspring[0, 1]))


def _is_slope(line: Any, expected: float) -> bool:
    """Within three standard errors, which one fit in 400 misses by chance."""
    return bool(abs(line.slope - expected) <= 3.0 * line.stderr)


def _plus_minus(line: Any) -> str:
    return f"({line.slope / 1e7:.5f} ± {line.stderr / 1e7:.5f})e7 N/m"


_DRAWN_M = 20e-6
"""By servo 2, while servo 1 is commanded to stay: 200 N on the cable if both obeyed."""
_SHOWN = (0.1, 1.0, 10.0, 100.0)
"""kp in cable stiffnesses, of the lines drawn in Fig. 5."""
_END_OF_STEP = {
    "Euler": "nothing",
    "implicit": "speed",
    "implicitfast": "speed",
    "discrete": "speed and position",
}
"""The quantities that each integrator takes at the end of the step."""
_STABLE = "#CFE3F1"


def self_locking(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """Rest over a sweep of kp, and a map of integrators and steps, on Fig. 3 (b)."""
    command_m = np.linspace(0.0, _DRAWN_M, size["commands"])
    commands = np.stack([np.zeros_like(command_m), command_m], axis=-1)
    reached_m = {
        times: positions_at_rest_m(times * STIFFNESS_N_M, commands)[:, 1] for times in _SHOWN
    }
    times = np.geomspace(0.1, 100.0, size["gains"])
    error_m = np.array(
        [_DRAWN_M - positions_at_rest_m(kp, commands[-1:])[0, 1] for kp in times * STIFFNESS_N_M]
    )
    progress(0.2)
    side = size["side"]
    gains = np.geomspace(0.1, 100.0, side)
    steps_s = np.geomspace(1e-6, 1e-2, side)
    limits_s = {}
    bounded = {}
    for done, name in enumerate(INTEGRATORS, start=1):
        limits_s[name] = np.asarray(longest_bounded_step_s(gains * STIFFNESS_N_M, name))
        bounded[name] = np.array(
            [[stays_bounded(t * STIFFNESS_N_M, h, name) for h in steps_s] for t in gains]
        )
        progress(0.2 + 0.2 * done)
    missed = sum(
        int((stable != (steps_s < limits_s[name][:, None])).sum())
        for name, stable in bounded.items()
    )
    short = {gain: float(_closed_error_m(gain)) / _DRAWN_M for gain in _SHOWN}
    at_ten = int(np.argmin(np.abs(gains - 10.0)))
    limits_us = {name: 1e6 * float(limit[at_ten]) for name, limit in limits_s.items()}
    numbers = {
        "drawn_um": 1e6 * _DRAWN_M,
        "soft_short": short[0.1],
        "soft_reach": 1.0 - short[0.1],
        "stiff_short": short[10.0],
        "euler_us": limits_us["Euler"],
        "implicit_us": limits_us["implicitfast"],
        "gained": limits_us["implicitfast"] / limits_us["Euler"],
        "off": float(np.abs(error_m / _closed_error_m(times) - 1.0).max()),
        "missed": missed,
        "cells": side * side * len(INTEGRATORS),
        "reached": [
            (f"{gain:g} k", 1e6 * float(reached_m[gain][-1]), 100.0 * short[gain])
            for gain in _SHOWN
        ],
        "limits": [
            (name, taken, f"{limits_us[name]:.1f} µs" if np.isfinite(limits_us[name]) else "none")
            for name, taken in _END_OF_STEP.items()
        ],
    }
    return numbers, {
        "fig_5_joint_position": _position_figure(command_m, reached_m),
        "fig_5_stability": _stability_figure(gains, steps_s, bounded, limits_s),
    }


def _closed_error_m(times: Any) -> Any:
    """How far servo 2 rests short of its command, T / kp, with kp in cable stiffnesses."""
    unyielding_n = PRETENSION_N + STIFFNESS_N_M * _DRAWN_M
    kp = times * STIFFNESS_N_M
    return tension_at_rest_n(unyielding_n, STIFFNESS_N_M, kp, 2) / kp


def _position_figure(command_m: Array, reached_m: dict[float, Array]) -> Any:
    figure, axes = one_panel(3.9, width=0.62)
    axes.plot(1e6 * command_m, 1e6 * command_m, color=FLOOR, lw=1.0, label="joint = actuator")
    for n, (times, position_m) in enumerate(reversed(reached_m.items())):
        style = {"color": SERIES[n], "ls": DASHES[n], "lw": 2.0, "label": f"kp = {times:g} k"}
        axes.plot(1e6 * command_m, 1e6 * position_m, **style)
    axes.axhline(0.0, color=BLACK, lw=0.6)
    axes.set(xlabel="actuator position (command), µm", ylabel="joint position, µm")
    axes.legend(loc="upper left")
    return figure


def _stability_figure(
    gains: Array, steps_s: Array, bounded: dict[str, Array], limits_s: dict[str, Array]
) -> Any:
    """Which steps in s (H,) stay bounded at which kp (K,) in stiffnesses: (K, H) by integrator."""
    figure, grid_axes = panels(1, 4, 3.4, grid="", sharex=True, sharey=True)
    colours = ListedColormap([ORANGE, _STABLE])
    for axes, (name, stable) in zip(grid_axes[0], bounded.items(), strict=True):
        axes.pcolormesh(gains, steps_s, stable.T, cmap=colours, vmin=0, vmax=1, shading="nearest")
        if np.isfinite(limits_s[name]).all():
            axes.plot(gains, limits_s[name], color=BLACK, lw=1.8)
        axes.set(title=name, xscale="log", yscale="log", xlabel="kp / k")
    grid_axes[0, 0].set(ylabel="time step, s", ylim=(steps_s[0], steps_s[-1]))
    key: list[Any] = [
        Patch(color=_STABLE, label="stable"),
        Patch(color=ORANGE, label="unstable"),
        Line2D([], [], color=BLACK, lw=1.8, label="closed form"),
    ]
    figure.legend(handles=key, loc="outside upper right", ncols=3)
    return figure
