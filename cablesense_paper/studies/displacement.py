"""Table I and section II-A: an arm driven by the lengths of its cables."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cablesense_base.arrays import Array
from cablesense_paper.drawing import BLACK, panels, plot_by_cable
from cablesense_paper.studies.joint_course import PERIOD_S, trajectory_rad
from cablesense_paper.study import Progress
from cablesense_paper.study_result import StudyResult, study_result
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.kinematics import cable_jacobian_m, cable_lengths_m
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.model import build_spec

_TABLE_1 = (
    ("position", "simulation", "[6], [7], [10], [13]"),
    ("position", "physical", "[1]"),
    ("position and force", "simulation", "[8], [9], [11]"),
    ("force", "simulation", "[2], [4], [5]"),
    ("force", "physical", "[3]"),
    ("model predictive", "simulation", "[12]"),
)
"""The paper's eleven rows, by how the tendons are driven and where."""


def run(quick: bool, progress: Progress) -> StudyResult:
    """Lengths for the ±10° trajectory, by closed form and by MuJoCo, and back to angles."""
    mechanism = mechanism_of(open_arm("cdsm"))
    time_s = np.linspace(0.0, 2.0 * PERIOD_S, 81 if quick else 401)
    angles = trajectory_rad(
        time_s, list(range(0, mechanism.joint_count, 2)), mechanism.joint_count
    )
    commanded_m = held_lengths_m(mechanism, angles)
    measured_m = _lengths_by_mujoco_m(mechanism, angles, progress)
    row = len(angles) - 1 - len(angles) // 8  # at a peak
    recovered = _angles_of(mechanism, commanded_m[row])
    numbers = {
        "drawn_mm": 1e3 * np.abs(commanded_m).max(),
        "driven_by": _TABLE_1,
        "apart_m": float(np.abs(measured_m - measured_m[0] - commanded_m).max()),
        "missed_rad": float(np.abs(recovered - angles[row]).max()),
    }
    figures = {"displacement_lengths": _figure(time_s, angles, commanded_m)}
    return study_result("displacement", numbers, figures)


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


def _angles_of(mechanism: Mechanism, change_m: Array) -> Array:
    """Joint angles (2N,) with these changes of cable length (M,), by Gauss-Newton from zero."""
    angles = np.zeros(mechanism.joint_count)
    target_m = cable_lengths_m(mechanism, angles) + change_m
    for _ in range(12):
        missing = target_m - cable_lengths_m(mechanism, angles)
        jacobian = cable_jacobian_m(mechanism, angles)
        angles = angles + np.linalg.lstsq(jacobian, missing, rcond=None)[0]
    return np.asarray(angles)


def _figure(time_s: Array, angles: Array, commanded_m: Array) -> Any:
    figure, every = panels(2, 1, 4.6, sharex=True)
    top, bottom = every[:, 0]
    top.plot(time_s, np.rad2deg(angles[:, 0]), color=BLACK)
    top.set(ylabel="pitch of every joint, °")
    plot_by_cable(bottom, time_s, 1e3 * commanded_m)
    bottom.set(ylabel="change of cable length, mm")
    figure.legend(loc="outside right center")
    return figure
