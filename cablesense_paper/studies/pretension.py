"""Fig. 4, sections II-B and II-C: a cable 1 m long, tensioned and drawn."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy.stats import linregress

from cablesense_base.arrays import Array
from cablesense_gap.report.style import FLOOR
from cablesense_paper.cables import PRETENSION_N, STIFFNESS_N_M, fixed_and_driven
from cablesense_paper.drawing import BLACK, BLUE, ORANGE, one_panel, panels
from cablesense_paper.servo_cable import series_stiffness_n_m, starting_force_n, tension_at_rest_n
from cablesense_paper.study import Progress
from cablesense_paper.study_result import Agreement, StudyResult, study_result
from cablesense_sim.model import ACTUATOR_MASS_KG

_DRAWN_M = 10e-6
"""As the paper is silent on its drive signal: twice the pretension's stretch."""

_PERIOD_S = 1.0
_KP_OVER_STIFFNESS = 10.0
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


def run(quick: bool, progress: Progress) -> StudyResult:
    """The start in fine steps, then a drive signal out and back, on the model of Fig. 3 (a)."""
    kp = _KP_OVER_STIFFNESS * STIFFNESS_N_M
    omega = np.sqrt((kp + STIFFNESS_N_M) / ACTUATOR_MASS_KG)
    kv = 2.0 * _DAMPING_RATIO * ACTUATOR_MASS_KG * omega
    start = _started(kp, kv)
    progress(0.5)
    drive = _driven(kp, kv, 2 if quick else 6)
    progress(0.8)
    noise = np.random.default_rng(4).normal(0.0, _NOISE_N, len(drive.tension_n))
    by_position = linregress(drive.position_m, drive.tension_n + noise)
    by_command = linregress(drive.command_m, drive.tension_n + noise)
    series_n_m = float(series_stiffness_n_m(STIFFNESS_N_M, kp, 1))
    closed_n = starting_force_n(
        start.time_s, PRETENSION_N, STIFFNESS_N_M, (kp, kv, ACTUATOR_MASS_KG)
    )
    numbers = {
        "start_n": float(start.cable_n[0]),
        "rest_n": drive.rest_n,
        "closed_rest_n": float(tension_at_rest_n(PRETENSION_N, STIFFNESS_N_M, kp, 1)),
        "by_position": _plus_minus(by_position),
        "by_command": _plus_minus(by_command),
        "position_agrees": _slope_agrees(by_position, STIFFNESS_N_M),
        "command_agrees": _slope_agrees(by_command, series_n_m),
        "series": series_n_m / 1e7,
        "lowest_n": float(start.servo_n.min()),
        "highest_n": float(start.servo_n.max()),
        "cable_low_n": start.cable_n.min(),
        "off_n": float(np.abs(start.servo_n - closed_n).max()),
        "drawn_um": 1e6 * _DRAWN_M,
        "rows": _both_ways_to_the_pretension(),
    }
    figures = {
        "fig_4_pretension": _fig_4(start, drive, by_position),
        "fig_4_start": _start_figure(start, closed_n),
    }
    return study_result("pretension", numbers, figures)


def _started(kp: float, kv: float) -> _Start:
    model, data = _model(kp, kv, _START_STEP_S, mujoco.mjtIntegrator.mjINT_EULER)
    count = round(_START_S / _START_STEP_S)
    servo, cable = np.empty(count), np.empty(count)
    for row in range(count):
        mujoco.mj_forward(model, data)
        servo[row] = data.actuator_force[0]
        cable[row] = _tension_n(model, data)
        mujoco.mj_step(model, data)
    return _Start(_START_STEP_S * np.arange(float(count)), servo, cable)


def _driven(kp: float, kv: float, periods: int) -> _Drive:
    model, data = _model(kp, kv, _STEP_S)
    mujoco.mj_step(model, data, nstep=1000)
    mujoco.mj_forward(model, data)
    rest_n = _tension_n(model, data)
    time_s = _STEP_S * np.arange(float(round(periods * _PERIOD_S / _STEP_S)))
    command = 0.5 * _DRAWN_M * (1.0 - np.cos(2.0 * np.pi * time_s / _PERIOD_S))
    position, tension = np.empty_like(time_s), np.empty_like(time_s)
    for row, drawn in enumerate(command):
        data.ctrl[0] = drawn
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        position[row], tension[row] = data.qpos[0], _tension_n(model, data)
    return _Drive(time_s, command, position, tension, rest_n)


def _both_ways_to_the_pretension() -> list[tuple[str | float, ...]]:
    """Tension at rest by spring length, by control signal, and by closed form, for three kp."""
    rows: list[tuple[str | float, ...]] = []
    for times in (1.0, 10.0, 100.0):
        kp = times * STIFFNESS_N_M
        found = []
        for bias_m in (None, PRETENSION_N / STIFFNESS_N_M):
            model, data = _model(kp, 2.0 * np.sqrt(kp), _STEP_S, bias_m=bias_m)
            data.ctrl[0] = bias_m or 0.0
            mujoco.mj_step(model, data, nstep=2000)
            mujoco.mj_forward(model, data)
            found.append(_tension_n(model, data))
        closed_n = float(tension_at_rest_n(PRETENSION_N, STIFFNESS_N_M, kp, 1))
        rows.append((f"{times:.0f} k", *found, closed_n))
    return rows


def _model(
    kp: float,
    kv: float,
    step_s: float,
    integrator: Any = mujoco.mjtIntegrator.mjINT_DISCRETE,
    bias_m: float | None = None,
) -> Any:
    spec = fixed_and_driven(kp, kv, bias_m)
    spec.option.timestep = step_s
    spec.option.integrator = integrator
    model = spec.compile()
    return model, mujoco.MjData(model)


def _tension_n(model: Any, data: Any) -> float:
    return float(STIFFNESS_N_M * (data.ten_length[0] - model.tendon_lengthspring[0, 1]))


def _slope_agrees(line: Any, expected: float) -> Agreement:
    """Within three standard errors, which one fit in 400 misses by chance."""
    return Agreement.within(line.slope, expected, 3.0 * line.stderr)


def _plus_minus(line: Any) -> str:
    return f"({line.slope / 1e7:.5f} ± {line.stderr / 1e7:.5f})e7 N/m"


def _fig_4(start: _Start, drive: _Drive, line: Any) -> Any:
    figure, every = panels(1, 3, 3.3)
    a, b, c = every[0]
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
