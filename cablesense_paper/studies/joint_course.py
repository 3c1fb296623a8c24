"""Fig. 9 and section IV-A: the arm on a trajectory of ±10°, its joints, tensions and actuators."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.report.style import FLOOR
from cablesense_paper.drawing import BLACK, DASHES, SERIES, one_panel, panels, plot_by_cable
from cablesense_paper.study import Progress
from cablesense_paper.study_result import Agreement, StudyResult, study_result
from cablesense_sim.arm import open_arm
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium

AMPLITUDE_RAD = float(np.deg2rad(10.0))
PERIOD_S = 4.0
_PRETENSION_N = 50.0
_STEP_S = 1e-3
_SLIGHT_SHARE = 0.1
"""What counts as a slight change of the pretension; the paper gives no number."""


def trajectory_rad(time_s: Array, joints: list[int], joint_count: int) -> Array:
    """Joint angles (T, 2N) at times (T,), through −10°, 0°, 10°, 0° again and again.

    A sine in the given joints, the others at zero. The first period starts from standstill without
    a jolt; the whole periods after it are alike. The paper gives the four angles and that they
    repeat, and neither the period nor which joints.
    """
    risen = np.clip(time_s / PERIOD_S, 0.0, 1.0)
    envelope = risen**3 * (10.0 - 15.0 * risen + 6.0 * risen**2)
    angles = np.zeros((len(time_s), joint_count))
    swing = -AMPLITUDE_RAD * envelope * np.sin(2.0 * np.pi * time_s / PERIOD_S)
    angles[:, joints] = swing[:, None]
    return angles


class _Motion(NamedTuple):
    """The arm on the trajectory, T samples.

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


_QUANTITIES = (
    ("joint tracking error, largest", "°", "worst_deg"),
    ("joint tracking error, RMS", "°", "rms_deg"),
    ("lowest tension", "N", "lowest_n"),
    ("highest tension", "N", "highest_n"),
    ("actuator tracking error, largest", "µm", "worst_um"),
    ("actuator tracking error, RMS", "µm", "rms_um"),
)


def run(quick: bool, progress: Progress) -> StudyResult:
    """The trajectory in time with MuJoCo, with and without the arm's weight."""
    periods = 1 if quick else 3
    without_weight = _moved(0.0, periods)
    progress(0.4)
    with_weight = _moved(1.0, periods)
    progress(0.8)
    light, heavy = _statistics(without_weight), _statistics(with_weight)
    most_n = max(-light["low_n"], light["high_n"])
    after = without_weight.time_s >= PERIOD_S
    lag_m = np.abs(without_weight.short_m - without_weight.expected_short_m)[after].max()
    inertia_n = np.abs(without_weight.tension_n - without_weight.static_n)[after].max()
    slightly = most_n <= _SLIGHT_SHARE * _PRETENSION_N
    numbers = {
        "light": light,
        "heavy": heavy,
        "most_n": most_n,
        "slightly": Agreement.YES if slightly else Agreement.PARTLY,
        "lag_um": 1e6 * float(lag_m),
        "inertia_n": float(inertia_n),
        "rows": [(what, unit, light[key], heavy[key]) for what, unit, key in _QUANTITIES],
        "period_s": PERIOD_S,
    }
    figures = {
        "fig_9a_joints": _joint_figure(without_weight),
        "fig_9a_tensions": _tension_figure(without_weight),
        "fig_9b_actuators": _cable_figure(
            without_weight, 1e6 * without_weight.short_m, "command less position, µm"
        )[0],
        "fig_9_with_weight": _tension_figure(with_weight),
    }
    return study_result("joint_course", numbers, figures)


def _moved(weight: float, periods: int) -> _Motion:
    """The trajectory with gravity times `weight`."""
    arm = open_arm("cdsm")
    gravity = tuple(weight * g for g in arm.gravity_m_s2)
    dynamics = ArmDynamics(arm.model_copy(update={"gravity_m_s2": gravity}), _STEP_S)
    model, data = dynamics.model, dynamics.data
    time_s = _STEP_S * np.arange(1.0, 1.0 + round((periods + 1) * PERIOD_S / _STEP_S))
    commands = trajectory_rad(time_s, list(range(0, arm.joint_count, 2)), arm.joint_count)
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
    return _Motion(time_s, commands, angles, tensions, static, short, expected)


def _statistics(motion: _Motion) -> dict[str, float]:
    """From the end of the first period; `low_n` and `high_n` are about the pretension."""
    after = motion.time_s >= PERIOD_S
    error_deg = np.rad2deg(motion.angle_rad - motion.command_rad)[after]
    short_um = 1e6 * motion.short_m[after]
    lowest_n, highest_n = (float(f(motion.tension_n[after])) for f in (np.min, np.max))
    return {
        "worst_deg": float(np.abs(error_deg).max()),
        "rms_deg": float(np.sqrt((error_deg**2).mean())),
        "lowest_n": lowest_n,
        "highest_n": highest_n,
        "low_n": lowest_n - _PRETENSION_N,
        "high_n": highest_n - _PRETENSION_N,
        "worst_um": float(np.abs(short_um).max()),
        "rms_um": float(np.sqrt((short_um**2).mean())),
    }


def _joint_figure(motion: _Motion) -> Any:
    figure, every = panels(2, 1, 4.2, sharex=True, height_ratios=(1.4, 1.0))
    above, below = every[:, 0]
    time_s, command_deg = motion.time_s, np.rad2deg(motion.command_rad[:, ::2])
    above.plot(time_s, command_deg[:, 0], color=BLACK, lw=1.0, label="command")
    for n, angle_deg in enumerate(np.rad2deg(motion.angle_rad[:, ::2]).T):
        style: dict[str, Any] = {"color": SERIES[n], "ls": DASHES[n], "lw": 1.8}
        above.plot(time_s, angle_deg, label=f"joint {n + 1}", **style)
        below.plot(time_s, angle_deg - command_deg[:, n], **style)
    above.set(ylabel="pitch, °")
    below.set(xlabel="time, s", ylabel="pitch less command, °", xlim=(0.0, time_s[-1]))
    figure.legend(loc="outside right center")
    return figure


def _tension_figure(motion: _Motion) -> Any:
    figure, axes = _cable_figure(motion, motion.tension_n, "cable tension, N")
    axes.axhline(_PRETENSION_N, color=FLOOR, lw=1.0)
    return figure


def _cable_figure(motion: _Motion, values: Array, label: str) -> tuple[Any, Any]:
    figure, axes = one_panel(3.1)
    plot_by_cable(axes, motion.time_s[::10], values[::10], lw=1.3)
    axes.set(ylabel=label, xlim=(0.0, motion.time_s[-1]))
    figure.legend(loc="outside right center")
    return figure, axes
