"""Fig. 3: the three tendons on which the paper studies a cable."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import matplotlib.pyplot as plt
import mujoco
import numpy as np

from cablesense_gap.report.style import WIDTH_IN
from examples.paper.cables import (
    CYLINDER_RADIUS_M,
    SCENES,
    Pixels,
    rendered_scenes,
    scene,
)
from examples.paper.drawing import BLACK, BLUE, VERMILION
from examples.paper.study import Figures, Numbers, Progress

_USES = ("stiffness and pretension", "self-locking", "friction")


def tendons(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """The three models: rendered, or drawn from MuJoCo's numbers; and measured."""
    pictures, backend = rendered_scenes(SCENES, 960, 500)
    progress(0.8)
    rows = []
    for name, use in zip(SCENES, _USES, strict=True):
        model, data = scene(name)
        stretch = data.ten_length - model.tendon_lengthspring[:, 1]
        tension_n = float((model.tendon_stiffness * stretch).max())
        rows.append((name, float(data.ten_length.sum()), tension_n, use))
    how = (
        f"Rendered by MuJoCo (OpenGL by {backend}); cables and blocks are enlarged."
        if pictures
        else "This machine has no OpenGL for MuJoCo's renderer, so this is a drawing of what "
        "MuJoCo computes: the tendons' paths and the cylinder of the same models."
    )
    numbers = {
        "how": how,
        "rows": rows,
        "off_m": max(abs(row[1] - 1.0) for row in rows),
        "off_n": max(abs(row[2] - 50.0) for row in rows),
    }
    return numbers, {"fig_3_tendons": _figure(pictures)}


def _figure(pictures: list[Pixels]) -> Any:
    figure = plt.figure(figsize=(WIDTH_IN, 2.1), layout="constrained")
    for n, name in enumerate(SCENES):
        if pictures:
            axes: Any = figure.add_subplot(1, 3, n + 1)
            axes.imshow(pictures[n])
            axes.set_axis_off()
        else:
            axes = figure.add_subplot(1, 3, n + 1, projection="3d")
            _draw(axes, name)
        axes.set_title(f"({'abc'[n]}) {name}")
    return figure


def _draw(axes: Any, name: str) -> None:
    """A scene as MuJoCo has it in `mjData`: paths of the tendons, driven and fixed ends."""
    model, data = scene(name)
    cylinders = model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER
    for tendon in range(model.ntendon):
        first, count = data.ten_wrapadr[tendon], data.ten_wrapnum[tendon]
        corners = data.wrap_xpos.reshape(-1, 3)[first : first + count]
        path = np.concatenate([np.linspace(*ends, 24) for ends in pairwise(corners)])
        if cylinders.any():  # chords become arcs
            reach = np.hypot(path[:, 0], path[:, 2])
            path[:, [0, 2]] *= np.maximum(1.0, CYLINDER_RADIUS_M / reach)[:, None]
        axes.plot(*path.T, color=VERMILION, lw=2.0)
    for geom, place in enumerate(data.geom_xpos):
        if cylinders[geom]:
            radius, half = model.geom_size[geom, :2]
            angle, along = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 40), np.array([-half, half]))
            x, y, z = radius * np.sin(angle), along, radius * np.cos(angle)
            surface = (at + offset for at, offset in zip(place, (x, y, z), strict=True))
            axes.plot_surface(*surface, color="#B8BFC9", alpha=0.9, linewidth=0)
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
