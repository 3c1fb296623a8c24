"""Fig. 5 and section II-D: how stiff a servo must be, and which time steps bear that."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_gap.report.style import FLOOR, plain_log_ticks
from cablesense_paper.cables import PRETENSION_N, STIFFNESS_N_M
from cablesense_paper.drawing import BLACK, BLUE, DASHES, ORANGE, SERIES, one_panel, panels
from cablesense_paper.servo_cable import (
    INTEGRATORS,
    longest_bounded_step_s,
    positions_at_rest_m,
    stays_bounded,
    steady_error_m,
)
from cablesense_paper.study import Progress
from cablesense_paper.study_result import Agreement, StudyResult, study_result, study_size

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


class _Map(NamedTuple):
    """Which steps stay bounded: kp in stiffnesses (K,), steps (H,), and by integrator (K, H)."""

    times: Array
    step_s: Array
    bounded: dict[str, NDArray[np.bool_]]
    limit_s: dict[str, Array]


def run(quick: bool, progress: Progress) -> StudyResult:
    """Rest over a sweep of kp, and a map of integrators and steps, on Fig. 3 (b)."""
    size = study_size("self_locking", quick)
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
    stability = _stability(size["side"], progress)
    missed = sum(
        int((bounded != (stability.step_s < stability.limit_s[name][:, None])).sum())
        for name, bounded in stability.bounded.items()
    )
    short = {one: float(_closed_error_m(one)) / _DRAWN_M for one in _SHOWN}
    at_ten = int(np.argmin(np.abs(stability.times - 10.0)))
    limits_us = {name: 1e6 * float(limit[at_ten]) for name, limit in stability.limit_s.items()}
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
        "cells": sum(bounded.size for bounded in stability.bounded.values()),
        "map_agrees": Agreement.YES if missed == 0 else Agreement.PARTLY,
        "reached": [
            (f"{one:g} k", 1e6 * float(reached_m[one][-1]), 100.0 * short[one]) for one in _SHOWN
        ],
        "limits": [
            (name, taken, f"{limits_us[name]:.1f} µs" if np.isfinite(limits_us[name]) else "none")
            for name, taken in _END_OF_STEP.items()
        ],
    }
    figures = {
        "fig_5_joint_position": _position_figure(command_m, reached_m),
        "fig_5_steady_error": _error_figure(times, error_m, closed_m),
        "fig_5_stability": _stability_figure(stability),
    }
    return study_result("self_locking", numbers, figures)


def _closed_error_m(times: Any) -> Any:
    """By closed form, with kp in cable stiffnesses."""
    unyielding_n = PRETENSION_N + STIFFNESS_N_M * _DRAWN_M
    return steady_error_m(unyielding_n, STIFFNESS_N_M, times * STIFFNESS_N_M, 2)


def _stability(side: int, progress: Progress) -> _Map:
    times, step_s = np.geomspace(0.1, 100.0, side), np.geomspace(1e-6, 1e-2, side)
    bounded, limits = {}, {}
    for done, name in enumerate(INTEGRATORS, start=1):
        limits[name] = np.asarray(longest_bounded_step_s(times * STIFFNESS_N_M, name))
        bounded[name] = np.array(
            [[stays_bounded(t * STIFFNESS_N_M, h, name) for h in step_s] for t in times]
        )
        progress(0.2 + 0.2 * done)
    return _Map(times, step_s, bounded, limits)


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


def _stability_figure(stability: _Map) -> Any:
    figure, every = panels(1, 4, 3.4, grid="", sharex=True, sharey=True)
    colours = ListedColormap([ORANGE, _STABLE])
    for axes, (name, bounded) in zip(every[0], stability.bounded.items(), strict=True):
        axes.pcolormesh(
            stability.times, stability.step_s, bounded.T, cmap=colours, vmin=0, vmax=1,
            shading="nearest",
        )  # fmt: skip
        if np.isfinite(stability.limit_s[name]).all():
            axes.plot(stability.times, stability.limit_s[name], color=BLACK, lw=1.8)
        axes.set(title=name, xscale="log", yscale="log", xlabel="kp / k")
    every[0, 0].set(ylabel="time step, s", ylim=(stability.step_s[0], stability.step_s[-1]))
    key: list[Any] = [
        Patch(color=_STABLE, label="stable"),
        Patch(color=ORANGE, label="unstable"),
        Line2D([], [], color=BLACK, lw=1.8, label="closed form"),
    ]
    figure.legend(handles=key, loc="outside upper right", ncols=3)
    return figure
