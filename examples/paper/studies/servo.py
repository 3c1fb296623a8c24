"""Fig. 4 and 5, sections II-B to II-D: a cable 1 m long, tensioned and drawn by servos.

How stiff a servo must be, and which time steps bear that.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.stats import linregress

from cablesense_base import Array
from cablesense_gap.report.style import FLOOR, plain_log_ticks
from cablesense_sim.model import ACTUATOR_MASS_KG
from examples.paper.cables import PRETENSION_N, STIFFNESS_N_M, fixed_and_driven
from examples.paper.drawing import BLACK, BLUE, DASHES, ORANGE, SERIES, one_panel, panels
from examples.paper.servo_cable import (
    INTEGRATORS,
    longest_bounded_step_s,
    positions_at_rest_m,
    starting_force_n,
    stays_bounded,
    tension_at_rest_n,
)
from examples.paper.study import Figures, Numbers, Progress

_PULL_M = 10e-6
"""As the paper is silent on its drive signal: twice the pretension's stretch."""

_PERIOD_S = 1.0
_KP_N_M = 10.0 * STIFFNESS_N_M
"""An order of magnitude above the cable, section II-D."""

_DAMPING_RATIO = 0.03
"""Of the start; low, so that it swings as the paper's does."""

_START_S, _START_STEP_S, _STEP_S = 4e-3, 1e-6, 1e-3
_NOISE_N = 0.05
"""Of the arm's sensors: what gives the fitted slope an error."""


class _Start(NamedTuple):
    """Forces (T,) after the start, the command being zero."""

    time_s: Array
    servo_n: Array
    cable_n: Array


class _Drive(NamedTuple):
    """Signals (T,) while the drive goes out and back, and the tension at rest before."""

    time_s: Array
    command_m: Array
    position_m: Array
    tension_n: Array
    rest_n: float


def pretension(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """The start in fine steps, then a drive signal out and back, on the model of Fig. 3 (a)."""
    omega = np.sqrt((_KP_N_M + STIFFNESS_N_M) / ACTUATOR_MASS_KG)
    kv = 2.0 * _DAMPING_RATIO * ACTUATOR_MASS_KG * omega
    start = _started(kv)
    progress(0.5)
    drive = _driven(kv, size["periods"])
    progress(0.8)
    noise = np.random.default_rng(4).normal(0.0, _NOISE_N, len(drive.tension_n))
    by_position = linregress(drive.position_m, drive.tension_n + noise)
    by_command = linregress(drive.command_m, drive.tension_n + noise)
    series_n_m = float(tension_at_rest_n(STIFFNESS_N_M, STIFFNESS_N_M, _KP_N_M, 1))
    servo = (_KP_N_M, kv, ACTUATOR_MASS_KG)
    closed_n = starting_force_n(start.time_s, PRETENSION_N, STIFFNESS_N_M, servo)
    numbers = {
        "start_n": float(start.cable_n[0]),
        "rest_n": drive.rest_n,
        "closed_rest_n": float(tension_at_rest_n(PRETENSION_N, STIFFNESS_N_M, _KP_N_M, 1)),
        "by_position": _plus_minus(by_position),
        "by_command": _plus_minus(by_command),
        "position_agrees": _is_slope(by_position, STIFFNESS_N_M),
        "command_agrees": _is_slope(by_command, series_n_m),
        "series": series_n_m / 1e7,
        "lowest_n": float(start.servo_n.min()),
        "highest_n": float(start.servo_n.max()),
        "cable_low_n": start.cable_n.min(),
        "off_n": float(np.abs(start.servo_n - closed_n).max()),
        "drawn_um": 1e6 * _PULL_M,
        "rows": [_both_ways_to_the_pretension(times) for times in (1.0, 10.0, 100.0)],
    }
    return numbers, {
        "fig_4_pretension": _pretension_figure(start, drive, by_position),
        "fig_4_start": _start_figure(start, closed_n),
    }


def _started(kv: float) -> _Start:
    model, data = _model(_KP_N_M, kv)
    model.opt.timestep, model.opt.integrator = _START_STEP_S, mujoco.mjtIntegrator.mjINT_EULER
    count = round(_START_S / _START_STEP_S)
    servo, cable = np.empty(count), np.empty(count)
    for row in range(count):
        mujoco.mj_forward(model, data)
        servo[row] = data.actuator_force[0]
        cable[row] = _tension_n(model, data)
        mujoco.mj_step(model, data)
    return _Start(_START_STEP_S * np.arange(float(count)), servo, cable)


def _driven(kv: float, periods: int) -> _Drive:
    model, data = _model(_KP_N_M, kv)
    rest_n = _tension_at_rest_n(model, data, steps=1000)
    time_s = _STEP_S * np.arange(float(round(periods * _PERIOD_S / _STEP_S)))
    command = 0.5 * _PULL_M * (1.0 - np.cos(2.0 * np.pi * time_s / _PERIOD_S))
    position, tension = np.empty_like(time_s), np.empty_like(time_s)
    for row, drawn in enumerate(command):
        data.ctrl[0] = drawn
        tension[row] = _tension_at_rest_n(model, data, steps=1)
        position[row] = data.qpos[0]
    return _Drive(time_s, command, position, tension, rest_n)


def _both_ways_to_the_pretension(times: float) -> tuple[str | float, ...]:
    """Tension at rest by spring length, by control signal, and by closed form, for kp in k."""
    kp = times * STIFFNESS_N_M
    found = []
    for bias_m in (None, PRETENSION_N / STIFFNESS_N_M):
        model, data = _model(kp, 2.0 * np.sqrt(kp), bias_m)
        data.ctrl[0] = bias_m or 0.0
        found.append(_tension_at_rest_n(model, data, steps=2000))
    closed_n = float(tension_at_rest_n(PRETENSION_N, STIFFNESS_N_M, kp, 1))
    return f"{times:.0f} k", *found, closed_n


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


def _pretension_figure(start: _Start, drive: _Drive, line: Any) -> Any:
    figure, ((a, b, c),) = panels(1, 3, 3.3)
    a.plot(drive.time_s, 1e6 * drive.command_m, color=BLACK)
    a.set(title="(a)", xlabel="time, s", ylabel="actuator position (drive signal), µm")
    b.plot(start.time_s, start.servo_n, color=ORANGE, lw=1.0, label="start, at the actuator")
    b.plot(drive.time_s, drive.tension_n, color=BLUE, label="cable tension")
    b.set(title="(b)", xlabel="time, s", ylabel="tension, N", ylim=(0.0, None))
    b.legend(loc="lower center")
    c.plot(np.zeros(2), [start.servo_n.min(), start.servo_n.max()], color=ORANGE, lw=1.6)
    c.plot(1e6 * drive.position_m, drive.tension_n, color=BLUE)
    ends = np.array([drive.position_m.min(), drive.position_m.max()])
    c.plot(
        1e6 * ends, line.intercept + line.slope * ends, color=BLACK, ls=":", lw=2.0,
        label=f"fit: {line.slope / 1e7:.4f}e7 N/m",
    )  # fmt: skip
    c.set(title="(c)", xlabel="actuator position, µm", ylabel="tension, N", ylim=(0.0, None))
    c.legend(loc="lower right")
    return figure


def _start_figure(start: _Start, closed_n: Array) -> Any:
    figure, axes = one_panel(2.9)
    shown = start.time_s <= 3e-3
    time_ms = 1e3 * start.time_s[shown]
    axes.plot(time_ms, start.servo_n[shown], color=ORANGE, lw=2.4, label="force of the servo")
    axes.plot(time_ms, closed_n[shown], color=BLACK, ls=":", lw=1.4, label="closed form")
    axes.plot(time_ms, start.cable_n[shown], color=BLUE, ls="--", label="tension of the cable")
    axes.axhline(100.0, color=FLOOR, lw=1.0)
    axes.text(3.0, 101.0, "twice the pretension", ha="right", va="bottom", color=FLOOR)
    axes.set(xlabel="time since the start, ms", ylabel="force, N", ylim=(-3.0, 112.0))
    axes.set_xlim(0.0, 3.0)
    figure.legend(loc="outside upper right", ncols=3)
    return figure


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
"""What each integrator takes at the end of the step."""

_STABLE = "#CFE3F1"


def self_locking(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """Rest over a sweep of kp, and a map of integrators and steps, on Fig. 3 (b)."""
    command_m = np.linspace(0.0, _DRAWN_M, size["commands"])
    commands = np.stack([np.zeros_like(command_m), command_m], axis=-1)
    reached_m = {
        times: positions_at_rest_m(times * STIFFNESS_N_M, commands)[:, 1] for times in _SHOWN
    }
    progress(0.05)
    times = np.geomspace(0.1, 100.0, size["gains"])
    error_m = np.array(
        [_DRAWN_M - positions_at_rest_m(kp, commands[-1:])[0, 1] for kp in times * STIFFNESS_N_M]
    )
    closed_m = _closed_error_m(times)
    progress(0.2)
    side = size["side"]
    sides = np.geomspace(0.1, 100.0, side), np.geomspace(1e-6, 1e-2, side)
    limits_s, bounded = {}, {}
    for done, name in enumerate(INTEGRATORS, start=1):
        limits_s[name] = np.asarray(longest_bounded_step_s(sides[0] * STIFFNESS_N_M, name))
        bounded[name] = np.array(
            [[stays_bounded(t * STIFFNESS_N_M, h, name) for h in sides[1]] for t in sides[0]]
        )
        progress(0.2 + 0.2 * done)
    missed = sum(
        int((stable != (sides[1] < limits_s[name][:, None])).sum())
        for name, stable in bounded.items()
    )
    short = {one: float(_closed_error_m(one)) / _DRAWN_M for one in _SHOWN}
    at_ten = int(np.argmin(np.abs(sides[0] - 10.0)))
    limits_us = {name: 1e6 * float(limit[at_ten]) for name, limit in limits_s.items()}
    numbers = {
        "drawn_um": 1e6 * _DRAWN_M,
        "soft_short": short[0.1],
        "soft_reach": 1.0 - short[0.1],
        "stiff_short": short[10.0],
        "euler_us": limits_us["Euler"],
        "implicit_us": limits_us["implicitfast"],
        "gained": limits_us["implicitfast"] / limits_us["Euler"],
        "off": float(np.abs(error_m / closed_m - 1.0).max()),
        "missed": missed,
        "cells": side * side * len(INTEGRATORS),
        "reached": [
            (f"{one:g} k", 1e6 * float(reached_m[one][-1]), 100.0 * short[one]) for one in _SHOWN
        ],
        "limits": [
            (name, taken, f"{limits_us[name]:.1f} µs" if np.isfinite(limits_us[name]) else "none")
            for name, taken in _END_OF_STEP.items()
        ],
    }
    return numbers, {
        "fig_5_joint_position": _position_figure(command_m, reached_m),
        "fig_5_steady_error": _error_figure(times, error_m, closed_m),
        "fig_5_stability": _stability_figure(sides, bounded, limits_s),
    }


def _closed_error_m(times: Any) -> Any:
    """How far servo 2 rests short of its command, T / kp, with kp in cable stiffnesses."""
    unyielding_n, kp = PRETENSION_N + STIFFNESS_N_M * _DRAWN_M, times * STIFFNESS_N_M
    return tension_at_rest_n(unyielding_n, STIFFNESS_N_M, kp, 2) / kp


def _position_figure(command_m: Array, reached_m: dict[float, Array]) -> Any:
    figure, axes = one_panel(3.9, width=0.62)
    axes.plot(1e6 * command_m, 1e6 * command_m, color=FLOOR, lw=1.0, label="joint = actuator")
    for n, (times, position_m) in enumerate(reversed(reached_m.items())):
        axes.plot(
            1e6 * command_m, 1e6 * position_m, color=SERIES[n], ls=DASHES[n], lw=2.0,
            label=f"kp = {times:g} k",
        )  # fmt: skip
    axes.axhline(0.0, color=BLACK, lw=0.6)
    axes.set(xlabel="actuator position (command), µm", ylabel="joint position, µm")
    axes.legend(loc="upper left")
    return figure


def _error_figure(times: Array, error_m: Array, closed_m: Array) -> Any:
    figure, axes = one_panel(3.6, width=0.62)
    axes.loglog(times, 1e6 * closed_m, color=BLACK, lw=1.2, label="closed form, T / kp")
    axes.loglog(times, 1e6 * error_m, "o", color=BLUE, ms=5, label="MuJoCo at rest")
    axes.axvline(10.0, color=FLOOR, ls="--", lw=1.0)
    axes.text(
        10.5, 0.97, "the paper’s choice,\nabout ten times k", color=FLOOR, va="top",
        transform=axes.get_xaxis_transform(),
    )  # fmt: skip
    axes.set(xlabel="kp in cable stiffnesses k", ylabel="steady-state error, µm")
    for axis in (axes.xaxis, axes.yaxis):
        plain_log_ticks(axis)
    axes.legend(loc="lower left")
    return figure


def _stability_figure(
    sides: tuple[Array, Array], bounded: dict[str, NDArray[np.bool_]], limits_s: dict[str, Array]
) -> Any:
    """Which steps in s (H,) stay bounded at which kp (K,) in stiffnesses: (K, H) by integrator."""
    figure, every = panels(1, 4, 3.4, grid="", sharex=True, sharey=True)
    colours = ListedColormap([ORANGE, _STABLE])
    for axes, (name, stable) in zip(every[0], bounded.items(), strict=True):
        axes.pcolormesh(*sides, stable.T, cmap=colours, vmin=0, vmax=1, shading="nearest")
        if np.isfinite(limits_s[name]).all():
            axes.plot(sides[0], limits_s[name], color=BLACK, lw=1.8)
        axes.set(title=name, xscale="log", yscale="log", xlabel="kp / k")
    every[0, 0].set(ylabel="time step, s", ylim=(sides[1][0], sides[1][-1]))
    key: list[Any] = [
        Patch(color=_STABLE, label="stable"),
        Patch(color=ORANGE, label="unstable"),
        Line2D([], [], color=BLACK, lw=1.8, label="closed form"),
    ]
    figure.legend(handles=key, loc="outside upper right", ncols=3)
    return figure
