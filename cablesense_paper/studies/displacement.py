"""Table I and section II-A: an arm driven by the lengths of its cables."""

from __future__ import annotations

from typing import Any

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.report.style import WIDTH_IN
from cablesense_paper.joint_course import PERIOD_S, course_rad
from cablesense_paper.study import (
    BLACK,
    CLOSED_FORM,
    DASHES,
    SERIES,
    Agreement,
    Comparison,
    SmallTable,
    Study,
    StudyResult,
    Tell,
    picture,
)

ARM = "cdsm"
_TABLE_1 = (
    ("position", "simulation", "[6], [7], [10], [13]"),
    ("position", "physical", "[1]"),
    ("position and force", "simulation", "[8], [9], [11]"),
    ("force", "simulation", "[2], [4], [5]"),
    ("force", "physical", "[3]"),
    ("model predictive", "simulation", "[12]"),
)
"""The paper's eleven rows, by how the tendons are driven and where."""

_TOLERANCE_M = 1e-12
_TOLERANCE_RAD = 1e-9


def run(quick: bool, tell: Tell) -> StudyResult:
    """Lengths for the ±10° course, by closed form and by MuJoCo, and the way back to angles."""
    import mujoco

    from cablesense_sim import kinematics
    from cablesense_sim.arm import open_arm
    from cablesense_sim.build import mechanism_of
    from cablesense_sim.equilibrium import held_lengths_m
    from cablesense_sim.model import build_spec

    mechanism = mechanism_of(open_arm(ARM))
    time_s = np.linspace(0.0, 2.0 * PERIOD_S, 81 if quick else 401)
    angles = course_rad(time_s, list(range(0, mechanism.joint_count, 2)), mechanism.joint_count)
    held_m = held_lengths_m(mechanism, angles)
    model = build_spec(mechanism).compile()
    data = mujoco.MjData(model)
    joints = [
        model.joint(f"joint_{n // 2 + 1}_{('pitch', 'yaw')[n % 2]}").qposadr[0]
        for n in range(mechanism.joint_count)
    ]
    lengths = np.empty_like(held_m)
    for row, pose in enumerate(angles):
        data.qpos[joints] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_tendon(model, data)
        lengths[row] = data.ten_length
        tell(row / len(angles))
    by_mujoco_m = lengths - lengths[0]
    apart_m = float(np.abs(by_mujoco_m - held_m).max())
    recovered = _angles_of(mechanism, held_m[-1 - len(held_m) // 8], kinematics)
    missed = float(np.abs(recovered - angles[-1 - len(held_m) // 8]).max())
    return StudyResult(
        lead=(
            "Commanded joint angles become cable lengths by geometry alone, and MuJoCo measures "
            "the same lengths on its model. A cable is drawn by up to "
            f"{1e3 * np.abs(held_m).max():.1f} mm; what the cable's own give adds to that at 50 N "
            "is a few micrometres."
        ),
        pictures=(
            picture(
                "displacement_lengths",
                _figure(time_s, angles, held_m),
                "Section II-A: joint angles as commanded (top), and the cable lengths that this "
                "asks of the actuators (bottom; a negative change is a drawn cable). All four "
                "pitch joints move; cables that end on the same segment share a colour.",
                "Joint angles and commanded changes of the twelve cable lengths over time",
            ),
        ),
        tables=(
            SmallTable(
                "Table I of the paper, counted by how tendons are driven. The arm here is driven "
                "as the paper's: by position.",
                ("driven by", "on", "rows of Table I"),
                _TABLE_1,
            ),
        ),
        comparisons=(
            Comparison(
                "largest difference between commanded length and MuJoCo's tendon length",
                apart_m, 0.0, "m",
                Agreement.within(apart_m, 0.0, _TOLERANCE_M),
                "Both are the same geometry; the rest is rounding.",
                CLOSED_FORM,
            ),
            Comparison(
                "joint angles found again from twelve commanded lengths, largest error",
                missed, 0.0, "rad",
                Agreement.within(missed, 0.0, _TOLERANCE_RAD),
                "Twelve lengths fix eight angles, so displacement input fixes the pose.",
                CLOSED_FORM,
            ),
        ),
        notes=(
            "The paper states position input and shows its drive signal in Fig. 4 (a); it gives "
            "neither the period of the course nor which joints move.",
        ),
    )  # fmt: skip


def _angles_of(mechanism: Any, held_m: Array, kinematics: Any) -> Array:
    """Joint angles (2N,) with these cable lengths (M,), by Gauss and Newton from straight."""
    angles = np.zeros(mechanism.joint_count)
    straight = kinematics.cable_lengths_m(mechanism, angles)
    for _ in range(12):
        missing = straight + held_m - kinematics.cable_lengths_m(mechanism, angles)
        jacobian = kinematics.cable_jacobian_m(mechanism, angles)
        angles = angles + np.linalg.lstsq(jacobian, missing, rcond=None)[0]
    return np.asarray(angles)


def _figure(time_s: Array, angles_rad: Array, held_m: Array) -> Any:
    import matplotlib.pyplot as plt

    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(WIDTH_IN, 4.6), sharex=True, layout="constrained"
    )
    top.plot(time_s, np.rad2deg(angles_rad[:, 0]), color=BLACK)
    top.set(ylabel="pitch of every joint, °")
    cables = held_m.shape[1]
    for i in range(cables):
        bottom.plot(
            time_s,
            1e3 * held_m[:, i],
            color=SERIES[i // 3],
            ls=DASHES[i % 3],
            label=f"cable {i + 1}",
        )
    bottom.set(xlabel="time, s", ylabel="change of cable length, mm", xlim=(time_s[0], time_s[-1]))
    for axes in (top, bottom):
        axes.grid()
    figure.legend(loc="outside right center")
    return figure


STUDY = Study(
    name="displacement",
    title="Displacement actuation",
    place="Table I, II-A",
    order=10,
    quick="a fifth of the poses",
    run=run,
)
