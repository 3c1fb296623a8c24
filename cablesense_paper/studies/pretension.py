"""Fig. 4, sections II-B and II-C: a metre of cable, tensioned and drawn."""

from __future__ import annotations

from typing import Any

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.report.style import FLOOR, WIDTH_IN
from cablesense_paper.study import (
    BLACK,
    BLUE,
    CLOSED_FORM,
    ORANGE,
    Agreement,
    Comparison,
    Picture,
    SmallTable,
    Study,
    StudyResult,
    Tell,
    picture,
)

DRAWN_M = 10e-6
"""As the paper is silent on its drive signal: half the pretension's stretch and more."""

PERIOD_S = 1.0
KP_OVER_STIFFNESS = 10.0
"""An order of magnitude above the cable, section II-D."""

DAMPING_RATIO = 0.03
"""Of the start; low, so that it swings as the paper's does."""

_START_S, _START_STEP_S, _STEP_S = 4e-3, 1e-6, 1e-3
_NOISE_N = 0.05
"""Of the arm's sensors: what gives the fitted slope an error."""


def run(quick: bool, tell: Tell) -> StudyResult:
    """The start in fine steps, then a drive signal to and fro, on the model of Fig. 3 (a)."""
    from scipy.stats import linregress

    from cablesense_paper import servo_cable as closed
    from cablesense_paper.cables import PRETENSION_N, STIFFNESS_N_M
    from cablesense_sim.model import ACTUATOR_MASS_KG

    kp = KP_OVER_STIFFNESS * STIFFNESS_N_M
    omega = np.sqrt((kp + STIFFNESS_N_M) / ACTUATOR_MASS_KG)
    kv = 2.0 * DAMPING_RATIO * ACTUATOR_MASS_KG * omega
    start = _start(kp, kv)
    tell(0.5)
    driven = _driven(kp, kv, 2 if quick else 6)
    tell(0.8)
    noise = np.random.default_rng(4).normal(0.0, _NOISE_N, len(driven["tension_n"]))
    read_n = driven["tension_n"] + noise
    by_position = linregress(driven["position_m"], read_n)
    by_command = linregress(driven["command_m"], read_n)
    closed_n = closed.starting_force_n(
        start["time_s"], PRETENSION_N, STIFFNESS_N_M, (kp, kv, ACTUATOR_MASS_KG)
    )
    rest_n = float(closed.tension_at_rest_n(PRETENSION_N, STIFFNESS_N_M, kp, 1))
    series_n_m = float(closed.series_stiffness_n_m(STIFFNESS_N_M, kp, 1))
    peak_n = float(start["servo_n"].max())
    off_n = float(np.abs(start["servo_n"] - closed_n).max())
    return StudyResult(
        lead=(
            f"The cable starts at {start['cable_n'][0]:.2f} N, and its tension follows the "
            f"actuator's position with a slope of {_plus_minus(by_position)}: the stiffness that "
            "was put in. Two things that the paper leaves out: a servo gives way, so that only "
            f"{rest_n:.1f} N of the 50 N last at kp = 10 k; and the swing at the start is the "
            "servo's, which begins with no force at all."
        ),
        pictures=(_fig_4(start, driven, by_position), _start_picture(start, closed_n)),
        tables=(_pretension_table(),),
        comparisons=(
            Comparison(
                "tension at the start", float(start["cable_n"][0]), 50.0, "N",
                Agreement.within(float(start["cable_n"][0]), 50.0, 0.01),
                "1e7 N/m on 5 µm.",
            ),
            Comparison(
                "tension kept at rest, kp = 10 k", driven["rest_n"], 50.0, "N", Agreement.PARTLY,
                "The servo gives by T / kp, so a share kp / (k + kp) is kept; the paper's 50 N "
                "hold for an actuator that does not give.",
            ),
            Comparison(
                "tension kept at rest, kp = 10 k", driven["rest_n"], rest_n, "N",
                Agreement.within(driven["rest_n"], rest_n, 1e-3),
                "T0 / (1 + k / kp).", CLOSED_FORM,
            ),
            Comparison(
                "slope of tension against actuator position", _plus_minus(by_position), "1e7 N/m",
                "", _slope_agrees(by_position, STIFFNESS_N_M),
                "The position is the cable's own lengthening; the error is one standard error of "
                "a fit to readings with 0.05 N of noise.",
            ),
            Comparison(
                "slope of tension against command", _plus_minus(by_command),
                f"{series_n_m / 1e7:.5f}e7 N/m", "", _slope_agrees(by_command, series_n_m),
                "Cable and servo in series; this is what a controller meets.", CLOSED_FORM,
            ),
            Comparison(
                "highest force of the starting swing", peak_n, "about 100 N", "N",
                Agreement.PARTLY,
                "It comes near 2 T0 kp / (k + kp), which is 90.9 N here and 100 N only for an "
                "infinitely stiff servo; damping takes some too.",
            ),
            Comparison(
                "lowest force of the starting swing", float(start["servo_n"].min()), 0.0, "N",
                Agreement.within(float(start["servo_n"].min()), 0.0, 0.1),
                "The servo starts at its target and so without force. The cable's own tension "
                f"swings between {start['cable_n'].min():.1f} and 50 N only.",
            ),
            Comparison(
                "starting swing, largest distance from the closed form", off_n, 0.0, "N",
                Agreement.within(off_n, 0.0, 0.5),
                "A damped oscillator; the rest is the 1 µs step.", CLOSED_FORM,
            ),
        ),
        notes=(
            "The paper gives neither the amplitude of its drive signal nor kp of this model; here "
            f"the drive goes {1e6 * DRAWN_M:.0f} µm out and back, and kp is ten times the "
            "stiffness.",
        ),
    )  # fmt: skip


def _start(kp: float, kv: float) -> dict[str, Array]:
    """Forces after the start, command zero."""
    import mujoco

    model, data = _model(kp, kv, _START_STEP_S, mujoco.mjtIntegrator.mjINT_EULER)
    count = round(_START_S / _START_STEP_S)
    servo, cable = np.empty(count), np.empty(count)
    for row in range(count):
        mujoco.mj_forward(model, data)
        servo[row] = data.actuator_force[0]
        cable[row] = _tension_n(model, data)
        mujoco.mj_step(model, data)
    return {"time_s": _START_STEP_S * np.arange(float(count)), "servo_n": servo, "cable_n": cable}


def _driven(kp: float, kv: float, periods: int) -> dict[str, Any]:
    """Command, position and tension while the drive goes out and back."""
    import mujoco

    model, data = _model(kp, kv, _STEP_S, mujoco.mjtIntegrator.mjINT_DISCRETE)
    mujoco.mj_step(model, data, nstep=1000)
    mujoco.mj_forward(model, data)
    rest_n = _tension_n(model, data)
    time_s = _STEP_S * np.arange(round(periods * PERIOD_S / _STEP_S))
    command = 0.5 * DRAWN_M * (1.0 - np.cos(2.0 * np.pi * time_s / PERIOD_S))
    position, tension = np.empty_like(time_s), np.empty_like(time_s)
    for row, drawn in enumerate(command):
        data.ctrl[0] = drawn
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        position[row], tension[row] = data.qpos[0], _tension_n(model, data)
    return {
        "time_s": time_s,
        "command_m": command,
        "position_m": position,
        "tension_n": tension,
        "rest_n": rest_n,
    }


def _pretension_table() -> SmallTable:
    import mujoco

    from cablesense_paper.cables import PRETENSION_N, STIFFNESS_N_M
    from cablesense_paper.servo_cable import tension_at_rest_n

    rows: list[tuple[str | float, ...]] = []
    for times in (1.0, 10.0, 100.0):
        kp = times * STIFFNESS_N_M
        found = []
        for bias_m in (None, PRETENSION_N / STIFFNESS_N_M):
            discrete = mujoco.mjtIntegrator.mjINT_DISCRETE
            model, data = _model(kp, 2.0 * np.sqrt(kp), _STEP_S, discrete, bias_m)
            data.ctrl[0] = bias_m or 0.0
            mujoco.mj_step(model, data, nstep=2000)
            mujoco.mj_forward(model, data)
            found.append(_tension_n(model, data))
        closed_n = float(tension_at_rest_n(PRETENSION_N, STIFFNESS_N_M, kp, 1))
        rows.append((f"{times:.0f} k", *found, closed_n))
    return SmallTable(
        "The paper's two ways to 50 N: a spring length 5 µm too short, or 5 µm of control signal. "
        "Both come to the same, and both lose what the servo gives.",
        ("kp", "by spring length, N", "by control signal, N", "50 N / (1 + k / kp), N"),
        tuple(rows),
    )


def _model(
    kp: float, kv: float, step_s: float, integrator: Any, bias_m: float | None = None
) -> Any:
    import mujoco

    from cablesense_paper.cables import fixed_and_driven

    spec = fixed_and_driven(kp, kv, bias_m)
    spec.option.timestep = step_s
    spec.option.integrator = integrator
    model = spec.compile()
    return model, mujoco.MjData(model)


def _tension_n(model: Any, data: Any) -> float:
    from cablesense_paper.cables import STIFFNESS_N_M

    return float(STIFFNESS_N_M * (data.ten_length[0] - model.tendon_lengthspring[0, 1]))


def _slope_agrees(line: Any, expected: float) -> Agreement:
    """Within three standard errors, which one fit in 400 misses by chance."""
    return Agreement.within(line.slope, expected, 3.0 * line.stderr)


def _plus_minus(line: Any) -> str:
    return f"({line.slope / 1e7:.5f} ± {line.stderr / 1e7:.5f})e7 N/m"


def _fig_4(start: dict[str, Array], driven: dict[str, Any], line: Any) -> Picture:
    import matplotlib.pyplot as plt

    figure, (a, b, c) = plt.subplots(1, 3, figsize=(WIDTH_IN, 3.3), layout="constrained")
    time_s = driven["time_s"]
    a.plot(time_s, 1e6 * driven["command_m"], color=BLACK)
    a.set(title="(a)", xlabel="time, s", ylabel="actuator position (drive signal), µm")
    b.plot(start["time_s"], start["servo_n"], color=ORANGE, lw=1.0, label="start, at the actuator")
    b.plot(time_s, driven["tension_n"], color=BLUE, label="cable tension")
    b.set(title="(b)", xlabel="time, s", ylabel="tension, N", ylim=(0.0, None))
    b.legend(loc="lower center")
    c.plot(np.zeros(2), [start["servo_n"].min(), start["servo_n"].max()], color=ORANGE, lw=1.6)
    c.plot(1e6 * driven["position_m"], driven["tension_n"], color=BLUE)
    ends = np.array([driven["position_m"].min(), driven["position_m"].max()])
    c.plot(
        1e6 * ends, line.intercept + line.slope * ends, color=BLACK, ls=":", lw=2.0,
        label=f"fit: {line.slope / 1e7:.4f}e7 N/m",
    )  # fmt: skip
    c.set(title="(c)", xlabel="actuator position, µm", ylabel="tension, N", ylim=(0.0, None))
    c.legend(loc="lower right")
    for axes in (a, b, c):
        axes.grid()
    return picture(
        "fig_4_pretension",
        figure,
        "Fig. 4 of the paper. (a) Drive signal. (b) Tension over time; the line at zero is the "
        "swing of the start, force of the servo. (c) Tension against actuator position with the "
        "fitted line; the swing again as the vertical line at zero. The position begins below "
        "zero as the servo gives under the pretension.",
        "Drive signal over time, tension over time, and tension against actuator position",
    )


def _start_picture(start: dict[str, Array], closed_n: Array) -> Picture:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(WIDTH_IN, 2.9), layout="constrained")
    shown = start["time_s"] <= 3e-3
    time_ms = 1e3 * start["time_s"][shown]
    axes.plot(time_ms, start["servo_n"][shown], color=ORANGE, lw=2.4, label="force of the servo")
    axes.plot(time_ms, closed_n[shown], color=BLACK, ls=":", lw=1.4, label="closed form")
    axes.plot(time_ms, start["cable_n"][shown], color=BLUE, ls="--", label="tension of the cable")
    axes.axhline(100.0, color=FLOOR, lw=1.0)
    axes.text(3.0, 101.0, "twice the pretension", ha="right", va="bottom", color=FLOOR)
    axes.set(xlabel="time since the start, ms", ylabel="force, N", ylim=(-3.0, 112.0))
    axes.set_xlim(0.0, 3.0)
    axes.grid()
    figure.legend(loc="outside upper right", ncols=3)
    return picture(
        "fig_4_start",
        figure,
        "The vertical line of Fig. 4 (b) and (c), drawn out in time: the tensioned cable meets a "
        "servo that has no force yet. In steps of 1 µs with little damping; at this project's "
        "1 ms and critical damping the force is within 1 % of its rest after one step.",
        "Force of the servo and cable tension in the first three milliseconds",
    )


STUDY = Study(
    name="pretension",
    title="Pretension and elastic deformation",
    place="Fig. 4, II-B, II-C",
    order=30,
    quick="two periods of the drive signal rather than six",
    run=run,
)
