"""Fig. 3: the three tendons on which the paper studies a cable."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import matplotlib.pyplot as plt
import mujoco
import numpy as np

from cablesense_gap.report.style import WIDTH_IN
from paper.cables import (
    CYLINDER_RADIUS_M,
    around_a_cylinder,
    driven_at_both_ends,
    fixed_and_driven,
)
from paper.drawing import BLACK, BLUE, VERMILION
from paper.study import Figures, Numbers, Progress

_SCENES = {
    "fixed and driven": (fixed_and_driven(1e8, 1e4), "stiffness and pretension"),
    "driven at both ends": (driven_at_both_ends(1e8, 1e4), "self-locking"),
    "around a cylinder": (around_a_cylinder(np.pi * 2.0 / 3.0), "friction"),
}
"""Each model and its use, by name."""


def tendons(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """The three models, measured, and drawn from MuJoCo's numbers."""
    figure = plt.figure(figsize=(WIDTH_IN, 2.1), layout="constrained")
    rows = []
    for n, (name, (spec, use)) in enumerate(_SCENES.items()):
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        stretch = data.ten_length - model.tendon_lengthspring[:, 1]
        tension_n = float((model.tendon_stiffness * stretch).max())
        rows.append((name, float(data.ten_length.sum()), tension_n, use))
        axes: Any = figure.add_subplot(1, 3, n + 1, projection="3d")
        _draw(axes, model, data)
        axes.set_title(f"({'abc'[n]}) {name}")
    numbers = {
        "rows": rows,
        "off_m": max(abs(row[1] - 1.0) for row in rows),
        "off_n": max(abs(row[2] - 50.0) for row in rows),
    }
    return numbers, {"fig_3_tendons": figure}


def _draw(axes: Any, model: Any, data: Any) -> None:
    """A scene as MuJoCo has it in `mjData`: paths of the tendons, driven and fixed ends."""
    cylinders = model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER
    for first, count in zip(data.ten_wrapadr, data.ten_wrapnum, strict=True):
        corners = data.wrap_xpos.reshape(-1, 3)[first : first + count]
        path = np.concatenate([np.linspace(*ends, 24) for ends in pairwise(corners)])
        if cylinders.any():  # chords become arcs
            reach = np.hypot(path[:, 0], path[:, 2])
            path[:, [0, 2]] *= np.maximum(1.0, CYLINDER_RADIUS_M / reach)[:, None]
        axes.plot(*path.T, color=VERMILION, lw=2.0)
    for geom, place in enumerate(data.geom_xpos):
        if cylinders[geom]:
            angle = np.linspace(0.0, 2.0 * np.pi, 60)
            circle = CYLINDER_RADIUS_M * np.array([np.sin(angle), 0.0 * angle, np.cos(angle)])
            axes.plot(*(place[:, None] + circle), color=BLACK, lw=1.2)
        else:
            colour = BLUE if model.geom_bodyid[geom] != 0 else BLACK
            axes.scatter(*place, marker="s", color=colour, s=60, depthshade=False)
    middle, _, height = 0.5 * (data.geom_xpos.max(axis=0) + data.geom_xpos.min(axis=0))
    axes.set(
        xlim=(middle - 0.56, middle + 0.56), ylim=(-0.2, 0.2), zlim=(height - 0.2, height + 0.2)
    )
    axes.set_box_aspect((1.12, 0.4, 0.4), zoom=1.05)
    axes.view_init(elev=14.0, azim=-83.0)
    axes.set_axis_off()
