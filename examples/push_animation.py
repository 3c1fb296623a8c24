"""An animation: pushes along a simulated arm, and what twelve noisy tensions tell of them.

    python -m examples.push_animation [docs/images/push.gif]

The README shows it.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from cablesense_base import Array
from cablesense_contact import Calibrator, Judge, LawModel, Unloaded, find_model
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.judgement import ContactState
from cablesense_sim import mechanism_of, normal_force_n, open_arm, solve_equilibrium
from cablesense_sim.kinematics import chain
from cablesense_sim.replay import read_tensions_n

ARM = "cdsm_lab"
STRAIGHT_RAD = np.zeros(8)  # the axes of all segments are those of the base
# of each push: segment, first and last place in m, angle in degrees, largest force in N
PUSHES = ((2, 0.02, 0.09, 180.0, 60.0), (4, 0.03, 0.09, 0.0, 35.0), (3, 0.09, 0.02, 180.0, 50.0))
ARROW_M_N = 0.0013
COLOURS = 32  # with 256 the file is three times as large


def draw_force(
    side: Any, row: int, joints_m: Array, segment: int, place_m: float, force_n: Array
) -> None:
    """Draw a force (3,) on a segment of the arm (N + 1, 3) as an arrow and as a row of text."""
    colour = ("#E69F00", "#0072B2")[row]
    text = ("true:      ", "estimated: ")[row] + "no contact"
    size_n = float(np.linalg.norm(force_n))
    if size_n > 0.5:
        text = text[:11] + f"segment {segment}, {1e3 * place_m:3.0f} mm, {size_n:4.1f} N"
        axis = joints_m[segment] - joints_m[segment - 1]
        tip_m = joints_m[segment - 1] + place_m * axis / np.linalg.norm(axis) + [0.004 * row, 0, 0]
        tail_m = tip_m - ARROW_M_N * force_n
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 3.0, "shrinkA": 0, "shrinkB": 0}
        side.annotate("", tip_m[[0, 2]], tail_m[[0, 2]], arrowprops=arrow)
    style = {"color": colour, "family": "monospace", "weight": "bold"}
    side.text(0.0, 0.115 - 0.018 * row, text, **style)


def main(out: Path, frames: int = 60) -> None:
    """Draw the animation."""
    arm = open_arm(ARM)
    mechanism = mechanism_of(arm)
    free_n = solve_equilibrium(mechanism, STRAIGHT_RAD).tensions_n
    law = LawModel(find_model(f"{ARM}_anywhere"), arm)
    calibrator = Calibrator(FeltArm(arm), law)
    known = calibrator.updated(calibrator.by_tolerances(), Unloaded(free_n, STRAIGHT_RAD, 50))
    still = np.zeros((arm.joint_count, arm.joint_count))
    judge = Judge(FeltArm(arm))
    rng = np.random.default_rng(0)
    figure, (side, bars) = plt.subplots(1, 2, figsize=(8.4, 3.2), width_ratios=(2.4, 1.0))
    figure.set_layout_engine("constrained")
    pictures = []
    for turn in np.linspace(0.0, len(PUSHES), frames, endpoint=False):
        segment, first_m, last_m, angle_deg, largest_n = PUSHES[int(turn)]
        place_m = first_m + (last_m - first_m) * (turn % 1.0)
        size_n = largest_n * np.sin(np.pi * turn) ** 2
        pushed = replace(mechanism, contact_m=np.full(arm.segment_count, place_m))
        load_n = normal_force_n(pushed, STRAIGHT_RAD, segment, angle_deg, size_n)
        rest = solve_equilibrium(pushed, STRAIGHT_RAD, load_n)
        reading_n = read_tensions_n(rest.tensions_n, arm.sensors, rng)
        posterior = law(reading_n[None], STRAIGHT_RAD[None], known.mean, known.covariance, still)
        judgement = judge(posterior, reading_n)
        touched = judgement.state is not ContactState.FREE
        across_n = touched * posterior.force_n[0] * [0.0, 1.0, 1.0]

        pose = chain(pushed, rest.joint_angles_rad)
        end_m = pose.joint_m[-1] + pushed.segment_length_m[-1] * pose.rotation[-1, :, 0]
        joints_m = np.vstack([pose.joint_m, end_m])
        side.clear()
        side.plot(*joints_m.T[[0, 2]], color="#8A929B", lw=14, solid_capstyle="round")
        side.plot(*joints_m.T[[0, 2]], "o", color="white", ms=6)
        draw_force(side, 0, joints_m, segment, place_m, load_n[segment - 1])
        draw_force(side, 1, joints_m, judgement.segment, posterior.place_m[0], across_n)
        side.set(xlim=(-0.02, 0.555), ylim=(-0.09, 0.13), aspect="equal")
        side.axis("off")
        cables = np.arange(1, arm.cable_count + 1)
        bars.clear()
        bars.bar(cables, reading_n - free_n, color="#8A929B")
        bars.set(ylim=(-140, 140), xticks=cables, xlabel="cable", title="tension − tare, N")
        bars.tick_params(labelsize=7)
        figure.savefig(drawn := BytesIO(), dpi=90)
        pictures.append(Image.open(drawn).convert("RGB"))
    plt.close(figure)
    palette = pictures[frames // 2].quantize(COLOURS)
    first, *others = (p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures)
    out.parent.mkdir(parents=True, exist_ok=True)
    first.save(out, save_all=True, append_images=others, duration=100, loop=0)  # ms a frame
    print(out)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else Path("out/push.gif"))
