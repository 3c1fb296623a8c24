"""The whole arm driven, moved and loaded: Table I, Fig. 9 and Table II, sections II-A and IV-A."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_gap.report.style import GRID
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.kinematics import cable_jacobian_m, cable_lengths_m
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.model import build_spec
from cablesense_training.evaluation.comparison import STANDARD_GRAVITY_M_S2, read_table2
from paper.drawing import BLACK, BLUE, DASHES, ORANGE, SERIES, one_panel, panels, plot_by_cable
from paper.study import Figures, Numbers, Progress

AMPLITUDE_RAD = float(np.deg2rad(10.0))
PERIOD_S = 4.0
_PRETENSION_N = 50.0
_STEP_S = 1e-3
_SLIGHT_SHARE = 0.1
"""The limit of a slight change of the pretension; the paper gives no number."""


def trajectory_rad(time_s: Array, joint_count: int) -> Array:
    """Joint angles (T, 2N) at times (T,), through −10°, 0°, 10°, 0° again and again.

    A sine of all pitch joints, the others at zero. The first period starts from standstill without
    a jolt; the whole periods after it are alike. The paper gives the four angles and that they
    repeat, and neither the period nor which joints.
    """
    risen = np.clip(time_s / PERIOD_S, 0.0, 1.0)
    envelope = risen**3 * (10.0 - 15.0 * risen + 6.0 * risen**2)
    angles = np.zeros((len(time_s), joint_count))
    swing = -AMPLITUDE_RAD * envelope * np.sin(2.0 * np.pi * time_s / PERIOD_S)
    angles[:, ::2] = swing[:, None]
    return angles


def displacement(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """Lengths for the ±10° trajectory, by closed form and by MuJoCo, and back to angles."""
    mechanism = mechanism_of(open_arm("cdsm"))
    time_s = np.linspace(0.0, 2.0 * PERIOD_S, size["poses"])
    angles = trajectory_rad(time_s, mechanism.joint_count)
    commanded_m = held_lengths_m(mechanism, angles)
    measured_m = _lengths_by_mujoco_m(mechanism, angles, progress)
    row = len(angles) - 1 - len(angles) // 8  # at a peak
    recovered = np.zeros(mechanism.joint_count)
    target_m = cable_lengths_m(mechanism, recovered) + commanded_m[row]
    for _ in range(12):  # Gauss-Newton
        missing = target_m - cable_lengths_m(mechanism, recovered)
        jacobian = cable_jacobian_m(mechanism, recovered)
        recovered = recovered + np.linalg.lstsq(jacobian, missing, rcond=None)[0]
    figure, ((top,), (bottom,)) = panels(2, 1, 4.6, sharex=True)
    top.plot(time_s, np.rad2deg(angles[:, 0]), color=BLACK)
    top.set(ylabel="pitch of every joint, °")
    plot_by_cable(bottom, time_s, 1e3 * commanded_m)
    bottom.set(ylabel="change of cable length, mm")
    figure.legend(loc="outside right center")
    numbers = {
        "drawn_mm": 1e3 * np.abs(commanded_m).max(),
        "apart_m": _largest(measured_m - measured_m[0] - commanded_m),
        "missed_rad": _largest(recovered - angles[row]),
    }
    return numbers, {"displacement_lengths": figure}


def _lengths_by_mujoco_m(mechanism: Mechanism, angles: Array, progress: Progress) -> Array:
    """Tendon lengths (T, M) at joint angles (T, 2N)."""
    model = build_spec(mechanism).compile()
    data = mujoco.MjData(model)
    joints = [
        model.joint(f"joint_{n // 2 + 1}_{('pitch', 'yaw')[n % 2]}").qposadr[0]
        for n in range(mechanism.joint_count)
    ]
    lengths = np.empty((len(angles), model.ntendon))
    for row, pose in enumerate(angles):
        data.qpos[joints] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_tendon(model, data)
        lengths[row] = data.ten_length
        progress(row / len(angles))
    return lengths


class _Motion(NamedTuple):
    """T samples: times (T,), joint angles (T, 2N), tensions and actuators' lags (T, M).

    The statistics are of whole periods after the start; `low_n` and `high_n` are about the
    pretension, `lag_m` is how far actuators are off the servo's own law, `inertia_n` how far
    tensions are from those at rest under the same command.
    """

    time_s: Array
    command_rad: Array
    angle_rad: Array
    tension_n: Array
    short_m: Array
    statistics: dict[str, float]


def trajectory(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """The trajectory in time with MuJoCo, with and without the arm's weight."""
    without_weight = _moved(0.0, size["periods"])
    progress(0.4)
    with_weight = _moved(1.0, size["periods"])
    progress(0.8)
    light = without_weight.statistics
    heavy = with_weight.statistics
    most_n = max(-light["low_n"], light["high_n"])
    numbers = {
        "light": light,
        "heavy": heavy,
        "most_n": most_n,
        "slightly": most_n <= _SLIGHT_SHARE * _PRETENSION_N,
        "lag_um": 1e6 * light["lag_m"],
        "period_s": PERIOD_S,
    }
    time_s = without_weight.time_s
    short_um = 1e6 * without_weight.short_m
    return numbers, {
        "fig_9a_joints": _joint_figure(without_weight),
        "fig_9a_tensions": _cable_figure(time_s, without_weight.tension_n, "cable tension, N"),
        "fig_9b_actuators": _cable_figure(time_s, short_um, "command less position, µm"),
    }


def _moved(weight: float, periods: int) -> _Motion:
    """The trajectory with gravity times `weight`."""
    arm = open_arm("cdsm")
    gravity = tuple(weight * g for g in arm.gravity_m_s2)
    dynamics = ArmDynamics(arm.model_copy(update={"gravity_m_s2": gravity}), _STEP_S)
    model = dynamics.model
    data = dynamics.data
    time_s = _STEP_S * np.arange(1.0, 1.0 + round((periods + 1) * PERIOD_S / _STEP_S))
    commands = trajectory_rad(time_s, arm.joint_count)
    drawn_m = -held_lengths_m(dynamics.mechanism, commands)  # all at once, for speed
    screws = [model.joint(f"screw_{i + 1}").qposadr[0] for i in range(arm.cable_count)]
    angles = np.empty_like(commands)
    tensions = np.empty_like(drawn_m)
    short = np.empty_like(drawn_m)
    for row, drawn in enumerate(drawn_m):
        data.ctrl[:] = drawn
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_tendon(model, data)
        angles[row] = dynamics.joint_angles_rad
        tensions[row] = dynamics.tensions_n
        short[row] = drawn - data.qpos[screws]
    kp = -model.actuator_biasprm[0, 1]
    kv = -model.actuator_biasprm[0, 2]
    expected = (tensions + kv * np.gradient(drawn_m, _STEP_S, axis=0)) / kp
    at_rest = solve_equilibrium(dynamics.mechanism, commands).tensions_n
    after = time_s >= PERIOD_S
    error_deg = np.rad2deg(angles - commands)[after]
    short_um = 1e6 * short[after]
    lowest_n = float(tensions[after].min())
    highest_n = float(tensions[after].max())
    statistics = {
        "worst_deg": _largest(error_deg),
        "rms_deg": _rms(error_deg),
        "lowest_n": lowest_n,
        "highest_n": highest_n,
        "low_n": lowest_n - _PRETENSION_N,
        "high_n": highest_n - _PRETENSION_N,
        "worst_um": _largest(short_um),
        "rms_um": _rms(short_um),
        "lag_m": _largest((short - expected)[after]),
        "inertia_n": _largest((tensions - at_rest)[after]),
    }
    return _Motion(time_s, commands, angles, tensions, short, statistics)


def _joint_figure(motion: _Motion) -> Any:
    figure, ((above,), (below,)) = panels(2, 1, 4.2, sharex=True, height_ratios=(1.4, 1.0))
    time_s = motion.time_s
    command_deg = np.rad2deg(motion.command_rad[:, ::2])
    above.plot(time_s, command_deg[:, 0], color=BLACK, lw=1.0, label="command")
    for n, angle_deg in enumerate(np.rad2deg(motion.angle_rad[:, ::2]).T):
        style: dict[str, Any] = {"color": SERIES[n], "ls": DASHES[n], "lw": 1.8}
        above.plot(time_s, angle_deg, label=f"joint {n + 1}", **style)
        below.plot(time_s, angle_deg - command_deg[:, n], **style)
    above.set(ylabel="pitch, °")
    below.set(xlabel="time, s", ylabel="pitch less command, °", xlim=(0.0, time_s[-1]))
    figure.legend(loc="outside right center")
    return figure


def _cable_figure(time_s: Array, values: Array, label: str) -> Any:
    figure, axes = one_panel(3.1)
    plot_by_cable(axes, time_s[::10], values[::10], lw=1.3)
    axes.set(ylabel=label, xlim=(0.0, time_s[-1]))
    figure.legend(loc="outside right center")
    return figure


_SLOPE_LIMIT_N = 0.45
"""How near the part in proportion to the load is to come to the paper's simulation."""

_SOURCES = (
    ("physical, the paper’s", "D", BLACK),
    ("simulated, the paper’s", "s", ORANGE),
    ("simulated, here", "o", BLUE),
)
_CABLES = np.arange(1, 10)


def table_2(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """All six loads by statics and by MuJoCo stepped to rest, with the rows of the table."""
    table = read_table2()
    physical_n, paper_n = (
        np.stack([row.tension_difference_n for row in table if row.source == source])
        for source in ("physical", "simulated")
    )
    loads = [(row.segment, row.weight_n) for row in table if row.source == "physical"]
    names = [f"{weight / STANDARD_GRAVITY_M_S2:.0f} kg, segment {n}" for n, weight in loads]
    ours_n = _by_statics_n(loads)
    progress(0.3)
    statics_off_n = _largest(_by_stepping_n(loads) - ours_n)
    progress(0.7)
    differences = {
        "ours less physical": ours_n - physical_n,
        "the paper’s simulation less physical": paper_n - physical_n,
        "ours less the paper’s simulation": ours_n - paper_n,
    }
    error_n, paper_error_n, apart_n = differences.values()
    slopes_off_n = (ours_n[3:] - ours_n[:3]) - (paper_n[3:] - paper_n[:3])
    constant_n = -apart_n.mean(0)
    worst, paper_worst = (np.abs(error).argmax() for error in (error_n, paper_error_n))
    row, cable = np.unravel_index(worst, error_n.shape)
    correlation = float(np.corrcoef(ours_n.ravel(), physical_n.ravel())[0, 1])
    numbers = {
        "slope_limit_n": _SLOPE_LIMIT_N,
        "slopes_rms_n": _rms(slopes_off_n),
        "slopes_largest_n": _largest(slopes_off_n),
        "error_rms_n": _rms(error_n),
        "paper_error_rms_n": _rms(paper_error_n),
        "apart_rms_n": _rms(apart_n),
        "apart_less_constant_n": _rms(apart_n + constant_n),
        "paper_largest_n": _largest(paper_error_n),
        "largest_n": _largest(error_n),
        "which": "the same" if worst == paper_worst else "another",
        "cable": cable + 1,
        "load": names[int(row)],
        "share": 100.0 * _largest(error_n) / loads[int(row)][1],
        "correlation": correlation,
        "consistent": correlation > 0.98,
        "statics_off_n": statics_off_n,
        "constant": ", ".join(_signed(value) for value in constant_n),
        "values": [
            (name, source, *map(_signed, values))
            for name, *three in zip(names, physical_n, paper_n, ours_n, strict=True)
            for source, values in zip(("physical", "the paper’s", "ours"), three, strict=True)
        ],
        "errors": [
            (name, _largest(d), _rms(d), _largest(d[3:] - d[:3]), _rms(d[3:] - d[:3]))
            for name, d in differences.items()
        ],
    }
    return numbers, {"table_2_loads": _load_figure(names, (physical_n, paper_n, ours_n))}


def _by_statics_n(loads: Sequence[tuple[int, float]]) -> Array:
    """(K, 9) changes of tension under weights, of a segment and N, hung on the straight arm."""
    mechanism = mechanism_of(open_arm("cdsm_table2"))
    forces = np.zeros((1 + len(loads), mechanism.segment_count, 3))
    for row, (segment, weight_n) in enumerate(loads, start=1):
        forces[row, segment - 1, 2] = -weight_n
    rest = solve_equilibrium(mechanism, np.zeros((len(forces), mechanism.joint_count)), forces)
    return np.asarray(rest.tensions_n[1:] - rest.tensions_n[0])


def _by_stepping_n(loads: Sequence[tuple[int, float]]) -> Array:
    """The same by MuJoCo, stepped until the arm is at rest."""
    dynamics = ArmDynamics(open_arm("cdsm_table2"))
    dynamics.settle()
    unloaded = dynamics.tensions_n
    changes = []
    for segment, weight_n in loads:
        dynamics.reset()
        dynamics.load(segment, [0.0, 0.0, -weight_n])
        dynamics.settle()
        changes.append(dynamics.tensions_n - unloaded)
    return np.stack(changes)


def _signed(value: float) -> str:
    """Two decimals, with a true minus sign and none before nothing."""
    rounded = round(value, 2)
    return f"{rounded:+.2f}".replace("-", "−") if rounded else "0.00"


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def _largest(values: Array) -> float:
    return float(np.abs(values).max())


def _load_figure(names: list[str], three_n: tuple[Array, ...]) -> Any:
    figure, grid_axes = panels(2, 3, 5.2, grid="y", sharex=True, sharey=True)
    for row, axes in enumerate(grid_axes.ravel()):
        for n, (label, mark, colour) in enumerate(_SOURCES):
            x = _CABLES + 0.22 * (n - 1)
            changes_n = three_n[n][row]
            axes.vlines(x, 0.0, changes_n, color=colour, lw=1.1, alpha=0.55)
            axes.plot(x, changes_n, mark, color=colour, ms=5, label="" if row else label)
        axes.axhline(0.0, color=BLACK, lw=0.7)
        for border in (3.5, 6.5):
            axes.axvline(border, color=GRID, lw=1.4)
        axes.set(title=names[row], xticks=_CABLES)
    figure.supxlabel("cable (1 to 3 end on segment 1, 4 to 6 on 2, 7 to 9 on 3)", fontsize=9.5)
    figure.supylabel("change of tension, N", fontsize=9.5)
    figure.legend(loc="outside upper right", ncols=3)
    return figure
