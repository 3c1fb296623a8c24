"""Fig. 3: the three tendons on which the paper studies a cable."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_gap.report.style import WIDTH_IN
from cablesense_paper.study import (
    BLACK,
    BLUE,
    CLOSED_FORM,
    VERMILION,
    Agreement,
    Comparison,
    Picture,
    SmallTable,
    Study,
    StudyResult,
    Tell,
    picture,
)

WIDTH_PX, HEIGHT_PX = 960, 500
_TOLERANCE_M, _TOLERANCE_N = 1e-9, 1e-3


def run(quick: bool, tell: Tell) -> StudyResult:
    """The three models: rendered, or drawn from MuJoCo's numbers; and measured."""
    from cablesense_paper.cables import SCENES, rendered_scenes, scene

    pictures, backend = rendered_scenes(SCENES, WIDTH_PX, HEIGHT_PX)
    tell(0.8)
    lengths_m, tensions_n = {}, {}
    for name in SCENES:
        model, data = scene(name)
        stretch = data.ten_length - model.tendon_lengthspring[:, 1]
        lengths_m[name] = float(data.ten_length.sum())
        tensions_n[name] = float((model.tendon_stiffness * stretch).max())
    off_m = max(abs(length - 1.0) for length in lengths_m.values())
    off_n = max(abs(tension - 50.0) for tension in tensions_n.values())
    how = (
        f"Rendered by MuJoCo (OpenGL by {backend}); cables and blocks are enlarged."
        if pictures
        else "This machine has no OpenGL for MuJoCo's renderer, so this is a drawing of what "
        "MuJoCo computes: the tendons' paths and the cylinder of the same models."
    )
    return StudyResult(
        lead=(
            "The paper's three configurations as MuJoCo models of a cable 1 m long, 5 µm longer "
            "than its spring length, which makes 50 N."
        ),
        pictures=(_fig_3(pictures, how),),
        tables=(
            SmallTable(
                "Measured on the models before anything moves.",
                ("configuration", "cable length, m", "tension, N", "used for"),
                tuple(
                    (name, lengths_m[name], tensions_n[name], used)
                    for name, used in zip(
                        SCENES,
                        ("stiffness and pretension", "self-locking", "friction"),
                        strict=True,
                    )
                ),
            ),
        ),
        comparisons=(
            Comparison(
                "cable length of all three, largest difference", off_m, 0.0, "m",
                Agreement.within(off_m, 0.0, _TOLERANCE_M), "1 m each.",
            ),
            Comparison(
                "tension of all three, largest difference from 50 N", off_n, 0.0, "N",
                Agreement.within(off_n, 0.0, _TOLERANCE_N),
                "k (1 m − 0.999995 m); around the cylinder, in both halves.", CLOSED_FORM,
            ),
        ),
        notes=(
            "The paper draws its third cable as one tendon. Here it is two that meet on the "
            "cylinder, as one tendon would have the same tension on both sides.",
        ),
    )  # fmt: skip


def _fig_3(pictures: list[NDArray[np.uint8]], how: str) -> Picture:
    import matplotlib.pyplot as plt

    from cablesense_paper.cables import SCENES

    figure = plt.figure(figsize=(WIDTH_IN, 2.1), layout="constrained")
    for n, name in enumerate(SCENES):
        if pictures:
            axes = figure.add_subplot(1, 3, n + 1)
            axes.imshow(pictures[n])
            axes.set_axis_off()
        else:
            axes = figure.add_subplot(1, 3, n + 1, projection="3d")
            _draw(axes, name)
        axes.set_title(f"({'abc'[n]}) {name}")
    return picture(
        "fig_3_tendons",
        figure,
        f"Fig. 3 of the paper. Blue blocks are driven, dark ones fixed. {how}",
        "A cable fixed and driven, a cable driven at both ends, a cable around a cylinder",
    )


def _draw(axes: Any, name: str) -> None:
    """A scene as MuJoCo has it in `mjData`: paths of the tendons, driven and fixed ends."""
    import mujoco

    from cablesense_paper.cables import scene

    model, data = scene(name)
    for tendon in range(model.ntendon):
        first, count = data.ten_wrapadr[tendon], data.ten_wrapnum[tendon]
        points = data.wrap_xpos.reshape(-1, 3)[first : first + count]
        axes.plot(*_arced(points, _radius_m(model)).T, color=VERMILION, lw=2.0)
    for geom in range(model.ngeom):
        place = data.geom_xpos[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
            _draw_cylinder(axes, place, *model.geom_size[geom, :2])
        else:
            moved = model.geom_bodyid[geom] != 0
            colour = BLUE if moved else BLACK
            axes.scatter(*place, marker="s", color=colour, s=60, depthshade=False)
    middle, _, height = 0.5 * (data.geom_xpos.max(axis=0) + data.geom_xpos.min(axis=0))
    axes.set(
        xlim=(middle - 0.56, middle + 0.56), ylim=(-0.2, 0.2), zlim=(height - 0.2, height + 0.2)
    )
    axes.set_box_aspect((1.12, 0.4, 0.4), zoom=1.05)
    axes.view_init(elev=14.0, azim=-83.0)
    axes.set_axis_off()


def _radius_m(model: Any) -> float:
    import mujoco

    round_ones = model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER
    return float(model.geom_size[round_ones, 0].max()) if round_ones.any() else 0.0


def _arced(points: Array, radius_m: float) -> Array:
    """A path (P, 3) with the pieces that lie on the cylinder, about y, filled by arcs."""
    parts = [points[:1]]
    for start, end in pairwise(points):
        share = np.linspace(0.0, 1.0, 24)[1:, None]
        piece = start + share * (end - start)
        reach = np.hypot(piece[:, 0], piece[:, 2])
        on_it = np.hypot(start[[0, 2]], end[[0, 2]]).max() < 1.6 * radius_m
        if on_it:
            piece[:, [0, 2]] *= (radius_m / np.maximum(reach, 1e-9))[:, None]
        parts.append(piece)
    return np.concatenate(parts)


def _draw_cylinder(axes: Any, place: Array, radius_m: float, half_m: float) -> None:
    angle, along = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 40), np.array([-half_m, half_m]))
    axes.plot_surface(
        place[0] + radius_m * np.sin(angle),
        place[1] + along,
        place[2] + radius_m * np.cos(angle),
        color="#B8BFC9",
        alpha=0.9,
        linewidth=0,
    )


STUDY = Study(
    name="tendons",
    title="Three tendons in MuJoCo",
    place="Fig. 3",
    order=20,
    quick="",
    run=run,
)
