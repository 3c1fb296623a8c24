"""Draws an animation: pushes along a simulated arm, and what twelve noisy tensions tell of them.

python -m examples.push_animation [docs/images/push.gif]
"""

from __future__ import annotations

import sys
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from cablesense_base import Array
from cablesense_contact import LawModel, find_model
from cablesense_contact.calibration import Calibrator, Unloaded
from cablesense_contact.judgement import ContactState, Judge
from cablesense_sim import (
    mechanism_of,
    normal_force_n,
    open_arm,
    read_tensions_n,
    solve_equilibrium,
)
from cablesense_sim.kinematics import chain

OUT = Path("out/push.gif")
ARM = "cdsm_lab"
MODEL = "cdsm_lab_anywhere"
COMMAND_RAD = np.zeros(8)
PUSHES = ((2, 0.02, 0.09, 180.0, 60.0), (4, 0.03, 0.09, 0.0, 35.0), (3, 0.09, 0.02, 180.0, 50.0))
"""Segment, places at the beginning and the end, m, angle, deg, and largest force, N."""
TRUE = "#E69F00"
ESTIMATED = "#0072B2"
ARM_COLOUR = "#8A929B"
ARROW_M_N = 0.0013
FRAMES_A_SECOND = 10
DPI = 90
COLOURS = 32
"""Enough for lines, bars and smooth letters; with 256 the file is three times as large."""


Contact = tuple[int, float, Array]
"""Segment, place in m, force (3,) in N."""


class Frame(NamedTuple):
    """One moment: joints and the arm's end (N + 1, 3), readings less tare (M,), contacts."""

    joints_m: Array
    difference_n: Array
    true: Contact
    estimated: Contact | None


def simulated(frames: int) -> list[Frame]:
    """The pushes frame by frame, and an estimator's answers."""
    arm = open_arm(ARM)
    rng = np.random.default_rng(0)
    mechanism = mechanism_of(arm)
    law = LawModel(find_model(MODEL), arm)
    judge = Judge(arm)
    free_n = solve_equilibrium(mechanism, COMMAND_RAD).tensions_n
    calibrator = Calibrator(arm, law)
    tare = Unloaded(free_n, COMMAND_RAD, 50)
    known = calibrator.updated(calibrator.by_tolerances(), tare)
    still = np.zeros((arm.joint_count, arm.joint_count))
    turn = np.linspace(0.0, len(PUSHES), frames, endpoint=False)
    course = []
    for number, within in zip(turn.astype(int), turn % 1.0, strict=True):
        segment, first_m, last_m, angle_deg, largest_n = PUSHES[number]
        place_m = first_m + (last_m - first_m) * within
        pushed = replace(mechanism, contact_m=np.full(arm.segment_count, place_m))
        size_n = largest_n * np.sin(np.pi * within) ** 2
        load_n = normal_force_n(pushed, COMMAND_RAD, segment, angle_deg, size_n)
        rest = solve_equilibrium(pushed, COMMAND_RAD, load_n)
        bones = chain(pushed, rest.joint_angles_rad)
        end_m = bones.joint_m[-1] + pushed.segment_length_m[-1] * bones.rotation[-1, :, 0]
        reading_n = read_tensions_n(rest.tensions_n, arm.sensors, rng)
        difference_n = reading_n - free_n
        seen = law(reading_n[None], COMMAND_RAD[None], known.mean, known.covariance, still)
        judgement = judge(seen, reading_n)
        estimated = None
        if judgement.state is not ContactState.FREE:
            across_n = seen.force_n[0] * [0.0, 1.0, 1.0]  # straight, so in base axes too
            estimated = judgement.segment, float(seen.place_m[0]), across_n
        true = segment, place_m, load_n[segment - 1]
        course.append(Frame(np.vstack([bones.joint_m, end_m]), difference_n, true, estimated))
    return course


def draw(course: list[Frame], at: int, side: Any, bars: Any) -> None:
    """Draw one frame: the arm from its side with both forces, and the tension differences."""
    side.clear()
    joints_m, difference_n, true, estimated = course[at]
    side.plot(joints_m[:, 0], joints_m[:, 2], color=ARM_COLOUR, lw=14, solid_capstyle="round")
    side.plot(joints_m[:, 0], joints_m[:, 2], "o", color="white", ms=6)
    lines = []
    for contact, colour, name, beside_m in (
        (true, TRUE, "true", 0.0),
        (estimated, ESTIMATED, "estimated", 0.004),
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
    reach_m = max(frame.joints_m[:, 0].max() for frame in course)
    side.set(xlim=(-0.02, reach_m + 0.02), ylim=(-0.09, 0.13), aspect="equal")
    side.axis("off")
    bars.clear()
    cables = np.arange(1, len(difference_n) + 1)
    bars.bar(cables, difference_n, color=ARM_COLOUR)
    most_n = 1.1 * max(np.abs(frame.difference_n).max() for frame in course)
    bars.set(ylim=(-most_n, most_n), xticks=cables, xlabel="cable", title="tension − tare, N")
    bars.tick_params(labelsize=7)


def main(out: Path = OUT, frames: int = 60) -> None:
    """Draw the animation."""
    out.parent.mkdir(parents=True, exist_ok=True)
    course = simulated(frames)
    figure, (side, bars) = plt.subplots(
        1, 2, figsize=(8.4, 3.2), width_ratios=(2.4, 1.0), layout="constrained"
    )
    pictures = []
    for index in range(frames):
        draw(course, index, side, bars)
        figure.savefig(drawn := BytesIO(), dpi=DPI)
        pictures.append(Image.open(drawn).convert("RGB"))
    palette = pictures[len(pictures) // 2].quantize(COLOURS)
    first, *others = (p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures)
    first.save(out, save_all=True, append_images=others, duration=1000 // FRAMES_A_SECOND, loop=0)
    plt.close(figure)
    print(out)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else OUT)
