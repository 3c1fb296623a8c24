"""Fig. 9 and section IV-A: the arm on a course of ±10°, its joints, tensions and actuators."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.report.style import FLOOR, WIDTH_IN
from cablesense_paper.joint_course import PERIOD_S, course_rad
from cablesense_paper.study import (
    BLACK,
    CLOSED_FORM,
    DASHES,
    SERIES,
    Agreement,
    Comparison,
    Picture,
    SmallTable,
    Study,
    StudyResult,
    Tell,
    picture,
)

ARM = "cdsm"
PRETENSION_N = 50.0
_STEP_S = 1e-3
_SLIGHT_SHARE = 0.1
"""What counts as a slight change of the pretension; the paper gives no number."""


class _Ride(NamedTuple):
    """The arm on the course, T samples.

    Attributes:
        time_s: (T,).
        command_rad, angle_rad: (T, 2N).
        tension_n: (T, M) in time, and static_n: at rest under the same command.
        short_m: (T, M) actuators' commands less their positions, and expected_short_m: by the
            servo's own law.
    """

    time_s: Array
    command_rad: Array
    angle_rad: Array
    tension_n: Array
    static_n: Array
    short_m: Array
    expected_short_m: Array


def run(quick: bool, tell: Tell) -> StudyResult:
    """The course in time with MuJoCo, with and without the arm's weight."""
    periods = 1 if quick else 3
    light = _ride(0.0, periods)
    tell(0.4)
    heavy = _ride(1.0, periods)
    tell(0.8)
    numbers, with_weight = _numbers(light), _numbers(heavy)
    low_n, high_n = (numbers[name] - PRETENSION_N for name in ("lowest_n", "highest_n"))
    heavy_low_n, heavy_high_n = (
        with_weight[name] - PRETENSION_N for name in ("lowest_n", "highest_n")
    )
    most_n = max(-low_n, high_n)
    after = light.time_s >= PERIOD_S
    lag_um = 1e6 * float(np.abs(light.short_m - light.expected_short_m)[after].max())
    inertia_n = float(np.abs(light.tension_n - light.static_n)[after].max())
    return StudyResult(
        lead=(
            f"Joints follow ±10° to within {numbers['worst_deg']:.4f}°. Without weight, tensions "
            f"stay within {most_n:.1f} N of the pretension, as in the paper; with the arm's own "
            f"weight they move by {heavy_low_n:.0f} to {heavy_high_n:+.0f} N. Actuators are at "
            f"most {numbers['worst_um']:.1f} µm from their command."
        ),
        pictures=(
            _joints_picture(light),
            _tensions_picture(light),
            _fig_9b(light),
            _weight_picture(heavy),
        ),
        tables=(
            SmallTable(
                "The numbers of Fig. 9, of which the paper prints none; whole periods after the "
                "start.",
                ("quantity", "unit", "without weight", "with weight"),
                tuple(
                    (what, unit, numbers[name], with_weight[name])
                    for what, unit, name in (
                        ("joint tracking error, largest", "°", "worst_deg"),
                        ("joint tracking error, RMS", "°", "rms_deg"),
                        ("lowest tension", "N", "lowest_n"),
                        ("highest tension", "N", "highest_n"),
                        ("actuator tracking error, largest", "µm", "worst_um"),
                        ("actuator tracking error, RMS", "µm", "rms_um"),
                    )
                ),
            ),
        ),
        comparisons=(
            Comparison(
                "joint angles", f"within {numbers['worst_deg']:.4f}°",
                "accurately track the reference", "", Agreement.YES,
                "Cable lengths fix the pose, and cables give by micrometres.",
            ),
            Comparison(
                "tensions, arm without weight", f"{low_n:+.1f} to {high_n:+.1f} N about 50 N",
                "fluctuate slightly around the pretension", "",
                Agreement.YES if most_n <= _SLIGHT_SHARE * PRETENSION_N else Agreement.PARTLY,
                "Equal tensions do not quite balance at bent joints, and inertia adds a little.",
            ),
            Comparison(
                "tensions, arm with its weight",
                f"{heavy_low_n:+.0f} to {heavy_high_n:+.0f} N about 50 N",
                "fluctuate slightly around the pretension", "", Agreement.NO,
                "The weight takes tens of newtons from cables 50 mm off the axis. The paper's "
                "figure fits a lighter arm, or none of its weight; it does not say which.",
            ),
            Comparison(
                "actuator tracking error", f"at most {numbers['worst_um']:.1f} µm",
                "position control is effective", "", Agreement.YES,
                "Micrometres, of a draw of tens of millimetres.",
            ),
            Comparison(
                "actuator error, largest distance from (T + kv speed) / kp", lag_um, 0.0, "µm",
                Agreement.within(lag_um, 0.0, 0.05),
                "Only the load and the servo's damping hold an actuator back.", CLOSED_FORM,
            ),
            Comparison(
                "tension in time less tension at rest, largest", inertia_n, 0.0, "N",
                Agreement.within(inertia_n, 0.0, 2.0),
                "They share the arm's numbers and nothing else; inertia is the difference.",
                "this project’s statics",
            ),
        ),
        notes=(
            "The paper gives the four angles −10°, 0°, 10°, 0° of a periodic course in a plane, "
            "and neither its period nor which joints. Here all four pitch joints run through them "
            f"as a sine of {PERIOD_S:.0f} s; the first period rises from rest.",
            "Commands change at every step of 1 ms. Held for two steps they become a staircase of "
            "50 µm and more, of which each step is a blow to a cable of 1e7 N/m: tensions then "
            "swing by hundreds of newtons. A real controller of a stiff arm has to interpolate.",
        ),
    )  # fmt: skip


def _numbers(ride: _Ride) -> dict[str, float]:
    """What the table says of a ride, from the end of its first period."""
    after = ride.time_s >= PERIOD_S
    error_deg = np.rad2deg(ride.angle_rad - ride.command_rad)[after]
    short_um = 1e6 * ride.short_m[after]
    return {
        "worst_deg": float(np.abs(error_deg).max()),
        "rms_deg": float(np.sqrt((error_deg**2).mean())),
        "lowest_n": float(ride.tension_n[after].min()),
        "highest_n": float(ride.tension_n[after].max()),
        "worst_um": float(np.abs(short_um).max()),
        "rms_um": float(np.sqrt((short_um**2).mean())),
    }


def _ride(weight: float, periods: int) -> _Ride:
    """The course with gravity times `weight`."""
    import mujoco

    from cablesense_sim.arm import open_arm
    from cablesense_sim.dynamics import ArmDynamics
    from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium

    arm = open_arm(ARM)
    gravity = tuple(weight * g for g in arm.gravity_m_s2)
    dynamics = ArmDynamics(arm.model_copy(update={"gravity_m_s2": gravity}), _STEP_S)
    model, data = dynamics.model, dynamics.data
    time_s = _STEP_S * np.arange(1.0, 1.0 + round((periods + 1) * PERIOD_S / _STEP_S))
    commands = course_rad(time_s, list(range(0, arm.joint_count, 2)), arm.joint_count)
    drawn_m = -held_lengths_m(dynamics.mechanism, commands)  # all at once, for speed
    screws = [model.joint(f"screw_{i + 1}").qposadr[0] for i in range(arm.cable_count)]
    angles, tensions = np.empty_like(commands), np.empty_like(drawn_m)
    short = np.empty_like(drawn_m)
    for row, drawn in enumerate(drawn_m):
        data.ctrl[:] = drawn
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_tendon(model, data)
        angles[row], tensions[row] = dynamics.joint_angles_rad, dynamics.tensions_n
        short[row] = drawn - data.qpos[screws]
    kp, kv = -model.actuator_biasprm[0, 1], -model.actuator_biasprm[0, 2]
    expected = (tensions + kv * np.gradient(drawn_m, _STEP_S, axis=0)) / kp
    static = solve_equilibrium(dynamics.mechanism, commands).tensions_n
    return _Ride(time_s, commands, angles, tensions, static, short, expected)


def _lines(axes: Any, ride: _Ride, values: Array) -> None:
    """One line a cable: colour by segment, dashes within."""
    for i in range(values.shape[1]):
        axes.plot(
            ride.time_s[::10], values[::10, i], color=SERIES[i // 3], ls=DASHES[i % 3], lw=1.3,
            label=f"cable {i + 1}",
        )  # fmt: skip
    axes.grid()
    axes.set(xlabel="time, s", xlim=(0.0, ride.time_s[-1]))


def _joints_picture(ride: _Ride) -> Picture:
    import matplotlib.pyplot as plt

    figure, (above, below) = plt.subplots(
        2, 1, figsize=(WIDTH_IN, 4.2), sharex=True, height_ratios=(1.4, 1.0), layout="constrained"
    )
    above.plot(
        ride.time_s, np.rad2deg(ride.command_rad[:, 0]), color=BLACK, lw=1.0, label="command"
    )
    for n in range(ride.angle_rad.shape[1] // 2):
        angle, command = ride.angle_rad[:, 2 * n], ride.command_rad[:, 2 * n]
        style: dict[str, Any] = {"color": SERIES[n], "ls": DASHES[n], "lw": 1.8}
        above.plot(ride.time_s, np.rad2deg(angle), label=f"joint {n + 1}", **style)
        below.plot(ride.time_s, np.rad2deg(angle - command), **style)
    above.set(ylabel="pitch, °")
    below.set(xlabel="time, s", ylabel="pitch less command, °", xlim=(0.0, ride.time_s[-1]))
    for axes in (above, below):
        axes.grid()
    figure.legend(loc="outside right center")
    return picture(
        "fig_9a_joints",
        figure,
        "Fig. 9 (a) of the paper, left: joint angles on the course, for the arm without weight, "
        "and what they are off by.",
        "Pitch of four joints over time, and its errors",
    )


def _tensions_picture(ride: _Ride) -> Picture:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(WIDTH_IN, 3.1), layout="constrained")
    _lines(axes, ride, ride.tension_n)
    axes.axhline(PRETENSION_N, color=FLOOR, lw=1.0)
    axes.set(ylabel="cable tension, N")
    figure.legend(loc="outside right center")
    return picture(
        "fig_9a_tensions",
        figure,
        "Fig. 9 (a) of the paper, right: cable tensions on the course, for the arm without "
        "weight. The grey line is the pretension.",
        "Tensions of twelve cables over time, the arm having no weight",
    )


def _fig_9b(ride: _Ride) -> Picture:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(WIDTH_IN, 3.1), layout="constrained")
    _lines(axes, ride, 1e6 * ride.short_m)
    axes.set(ylabel="command less position, µm")
    figure.legend(loc="outside right center")
    return picture(
        "fig_9b_actuators",
        figure,
        "Fig. 9 (b) of the paper: tracking errors of the actuators, for the arm without weight. "
        "The pretension takes half a micrometre from a servo of 1e8 N/m; the rest is its damping.",
        "Tracking errors of twelve actuators over time",
    )


def _weight_picture(ride: _Ride) -> Picture:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(WIDTH_IN, 3.1), layout="constrained")
    _lines(axes, ride, ride.tension_n)
    axes.axhline(PRETENSION_N, color=FLOOR, lw=1.0)
    axes.set(ylabel="cable tension, N")
    figure.legend(loc="outside right center")
    return picture(
        "fig_9_with_weight",
        figure,
        "The same course with the arm's weight: tensions carry it, tens of newtons away from the "
        "pretension.",
        "Tensions of twelve cables over time, the arm having its weight",
    )


STUDY = Study(
    name="joint_course",
    title="The arm on a course",
    place="Fig. 9, IV-A",
    order=60,
    quick="two periods after the start rather than four",
    run=run,
)
