"""Draws an animation: pushes along a simulated arm, and what twelve noisy tensions tell of them.

python -m examples.push_animation [docs/images/push.gif]
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter

from cablesense_base import Array
from cablesense_sim import (
    mechanism_of,
    normal_force_n,
    open_arm,
    read_tensions_n,
    solve_equilibrium,
)
from cablesense_sim.kinematics import chain
from cablesense_training import Estimator, find_model, open_estimator

OUT = Path("out/push.gif")
ARM, MODEL = "cdsm_lab", "cdsm_lab_anywhere"
COMMAND_RAD = np.zeros(8)
PUSHES = ((2, 0.02, 0.09, 180.0, 60.0), (4, 0.03, 0.09, 0.0, 35.0), (3, 0.09, 0.02, 180.0, 50.0))
"""Segment, places at the beginning and the end, m, angle, deg, and largest force, N."""
TRUE, ESTIMATED, ARM_COLOUR = "#E69F00", "#0072B2", "#8A929B"
ARROW_M_N = 0.0013
FRAMES_A_SECOND, DPI = 10, 90


class Course:
    """The pushes, frame by frame: poses of the arm, readings, and estimates from them.

    Attributes:
        true: (frames,) segment, place in m, force in N.
        joints_m: (frames, N + 1, 3) joint centres and the end of the arm.
        difference_n: (frames, M) readings minus tare.
        estimates: one for each frame.
    """

    def __init__(self, frames: int) -> None:
        arm = open_arm(ARM)
        self.mechanism, rng = mechanism_of(arm), np.random.default_rng(0)
        turn = np.linspace(0.0, len(PUSHES), frames, endpoint=False)
        self.true, joints_m, readings_n = [], [], []
        for number, within in zip(turn.astype(int), turn % 1.0, strict=True):
            segment, first_m, last_m, angle_deg, largest_n = PUSHES[number]
            force_n = largest_n * np.sin(np.pi * within) ** 2
            place_m = first_m + (last_m - first_m) * within
            pushed = replace(self.mechanism, contact_m=np.full(arm.segment_count, place_m))
            load_n = normal_force_n(pushed, COMMAND_RAD, segment, angle_deg, force_n)
            rest = solve_equilibrium(pushed, COMMAND_RAD, load_n)
            bones = chain(pushed, rest.joint_angles_rad)
            end_m = bones.joint_m[-1] + pushed.segment_length_m[-1] * bones.rotation[-1, :, 0]
            joints_m.append(np.vstack([bones.joint_m, end_m]))
            readings_n.append(read_tensions_n(rest.tensions_n, arm.sensors, rng))
            self.true.append((segment, place_m, load_n[segment - 1]))
        self.joints_m = np.array(joints_m)
        free_n = solve_equilibrium(self.mechanism, COMMAND_RAD).tensions_n
        self.difference_n = np.array(readings_n) - free_n
        estimator = open_estimator(find_model(MODEL), arm)
        assert isinstance(estimator, Estimator)
        self.estimates = [estimator.estimate(row, COMMAND_RAD) for row in self.difference_n]

    def estimated(self, frame: int) -> tuple[int, float, Array] | None:
        """Segment, place and force (3,) of the contact that is estimated, if there is one."""
        found = self.estimates[frame]
        if not found.segment or found.place is None:
            return None
        force_n = normal_force_n(
            self.mechanism, COMMAND_RAD, found.segment, found.angle_deg, found.magnitude_n
        )
        return found.segment, found.place.place_m, force_n[found.segment - 1]


def draw(course: Course, frame: int, side: Any, bars: Any) -> None:
    """Draw one frame: the arm from its side with both forces, and the tension differences."""
    side.clear()
    joints_m = course.joints_m[frame]
    side.plot(joints_m[:, 0], joints_m[:, 2], color=ARM_COLOUR, lw=14, solid_capstyle="round")
    side.plot(joints_m[:, 0], joints_m[:, 2], "o", color="white", ms=6)
    lines = []
    for contact, colour, name, beside_m in (
        (course.true[frame], TRUE, "true", 0.0),
        (course.estimated(frame), ESTIMATED, "estimated", 0.004),
    ):
        if contact is None or np.linalg.norm(contact[2]) < 0.5:
            lines.append(("no contact", colour, name))
            continue
        segment, place_m, force_n = contact
        axis = joints_m[segment] - joints_m[segment - 1]
        tip_m = joints_m[segment - 1] + (place_m / np.linalg.norm(axis)) * axis
        tail_m = tip_m - ARROW_M_N * force_n
        style = {"arrowstyle": "-|>", "color": colour, "lw": 3.0, "shrinkA": 0, "shrinkB": 0}
        ends = [(end_m[0] + beside_m, end_m[2]) for end_m in (tip_m, tail_m)]
        side.annotate("", *ends, arrowprops=style)
        size_n = np.linalg.norm(force_n)
        lines.append(
            (f"segment {segment}, {1e3 * place_m:3.0f} mm, {size_n:4.1f} N", colour, name)
        )
    for row, (text, colour, name) in enumerate(lines):
        said = f"{name + ':':11}{text}"
        side.text(0.0, 0.115 - 0.018 * row, said, color=colour, family="monospace", weight="bold")
    reach_m = course.joints_m[..., 0].max()
    side.set(xlim=(-0.02, reach_m + 0.02), ylim=(-0.09, 0.13), aspect="equal")
    side.axis("off")
    bars.clear()
    cables = np.arange(1, course.difference_n.shape[1] + 1)
    bars.bar(cables, course.difference_n[frame], color=ARM_COLOUR)
    most_n = 1.1 * np.abs(course.difference_n).max()
    bars.set(ylim=(-most_n, most_n), xticks=cables, xlabel="cable", title="tension − tare, N")
    bars.tick_params(labelsize=7)


def main(out: Path = OUT, frames: int = 60) -> None:
    """Draw the animation."""
    out.parent.mkdir(parents=True, exist_ok=True)
    course = Course(frames)
    figure, (side, bars) = plt.subplots(
        1, 2, figsize=(8.4, 3.2), width_ratios=(2.4, 1.0), layout="constrained"
    )
    drawn = FuncAnimation(figure, lambda frame: draw(course, frame, side, bars), frames=frames)
    drawn.save(out, writer=PillowWriter(FRAMES_A_SECOND), dpi=DPI)
    plt.close(figure)
    print(out)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else OUT)
