"""The pictures of the headless demos, in one dark style: pushes on the arm, and the wall."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_base.files import written_whole
from cablesense_online.page.drawing import (
    ARROWS_APART_M,
    ESTIMATE_RGB,
    PLATE_MARGIN,
    TRUE_RGB,
    arrow_tail_m,
    cable_pieces,
    css,
    full_scale_n,
    plate_positions_m,
    routing_radius_m,
    segment_rgb,
    tension_rgb,
    unit,
)
from cablesense_online.page.live_arm import ShownContact, Snapshot
from cablesense_ros.demo.pushes import PushRecord, PushResult, summary
from cablesense_sim.kinematics import contact_points_m, joint_positions_m, segment_rotations
from cablesense_sim.mechanism import Mechanism

_GROUND, _INK, _DIM, _GRID = "#14171d", "#e8ebf0", "#9aa3b2", "#2c323c"
_PLATE = "#7e8a9c"
_STYLE: Any = {
    **dict.fromkeys(("figure.facecolor", "axes.facecolor", "savefig.facecolor"), _GROUND),
    **dict.fromkeys(("text.color", "axes.labelcolor"), _INK),
    **dict.fromkeys(("axes.edgecolor", "grid.color"), _GRID),
    **dict.fromkeys(("xtick.color", "ytick.color"), _DIM),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right"), False),
    "font.size": 10,
}
_DPI = 110
_HEAD_M = 0.034


@contextmanager
def _picture(path: Path, size_in: tuple[float, float]) -> Iterator[Any]:
    """A figure to draw on; then it is in its file as PNG, whole or not at all."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context(_STYLE):
        figure = plt.figure(figsize=size_in)
        yield figure
        with written_whole(path, CableSenseError) as part:
            figure.savefig(part, dpi=_DPI, format="png")
        plt.close(figure)


def draw_pushes(
    path: Path, mechanism: Mechanism, record: PushRecord, results: Sequence[PushResult]
) -> None:
    """Draw the arm at its hardest push, and true and estimated contacts over time."""
    found = summary(results)
    caption = f"{found['segment_right']} of {found['pushes']} pushes on the right segment"
    if found["direction_mae_deg"] is not None:
        caption += (
            f"; mean error {found['direction_mae_deg']:.2f}° in direction, "
            f"{found['magnitude_mae_n']:.2f} N in magnitude"
        )
    edges = {"left": 0.0, "right": 0.985, "top": 0.885, "bottom": 0.075}
    with _picture(path, (14.0, 8.0)) as figure:
        grid = figure.add_gridspec(1, 2, width_ratios=(1.3, 1), **edges)
        moment = _hardest_moment(record, results)
        _draw_arm(figure, grid[0], mechanism, record.snapshots[moment])
        _draw_time(figure, grid[1], record, mechanism.segment_count, record.times_s[moment])
        figure.text(0.03, 0.945, "CableSense: force from cable tensions", size=16, weight="bold")
        figure.text(0.03, 0.912, caption, size=10.5, color=_DIM)


def _hardest_moment(record: PushRecord, results: Sequence[PushResult]) -> int:
    """Late in the hardest push on the outer half of the arm, where the picture shows most."""
    found = [r for r in results if r.estimate is not None] or list(results)
    half = max(r.push.segment for r in found) / 2
    push = max(found, key=lambda r: (r.push.segment > half, r.push.magnitude_n)).push
    moment = int(np.searchsorted(record.times_s, push.end_s - 0.3))
    return min(moment, len(record.times_s) - 1)


def _draw_arm(figure: Any, place: Any, mechanism: Mechanism, snapshot: Snapshot) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    axes = figure.add_subplot(place, projection="3d", computed_zorder=False)
    pose = snapshot.joint_angles_rad
    joints, rotations = joint_positions_m(mechanism, pose), segment_rotations(mechanism, pose)
    _draw_plates(axes, mechanism, joints, rotations)
    tensions = snapshot.tensions_n if snapshot.tensions_n is not None else mechanism.pretension_n
    scale_n = full_scale_n(float(tensions.max()))
    ends_m, cable = cable_pieces(mechanism, joints, rotations)
    colours = tension_rgb(tensions, scale_n)[cable] / 255.0
    axes.add_collection3d(Line3DCollection(ends_m, colors=colours, linewidths=1.9, zorder=4))
    points = contact_points_m(mechanism, pose)
    for contact, rgb, kind, aside_m in (
        (snapshot.true, TRUE_RGB, "true", -ARROWS_APART_M / 2),
        (snapshot.estimate, ESTIMATE_RGB, "estimated", ARROWS_APART_M / 2),
    ):
        if contact is not None:
            point = points[contact.segment - 1] + aside_m * rotations[contact.segment - 1][:, 0]
            _draw_arrow(axes, point, contact, css(rgb))
            force = f"{contact.magnitude_n:.1f} N at {contact.angle_deg:.1f}°"
            label = f"{kind}: segment {contact.segment}, {force}"
            axes.plot([], [], [], color=css(rgb), lw=4, label=label)
    axes.legend(loc="upper left", bbox_to_anchor=(0.02, 0.93), frameon=False, fontsize=11)
    _frame(axes, mechanism)
    stops = tension_rgb(np.linspace(0.0, scale_n, 64), scale_n) / 255.0
    colour_map = LinearSegmentedColormap.from_list("tension", list(stops))
    bar = figure.colorbar(
        ScalarMappable(Normalize(0.0, scale_n), colour_map),
        cax=axes.inset_axes((0.28, 0.05, 0.46, 0.018)),
        orientation="horizontal",
        label="cable tension, N (0 is slack)",
    )
    bar.outline.set_visible(False)


def _draw_plates(axes: Any, mechanism: Mechanism, joints: Array, rotations: Array) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    turn = np.linspace(0.0, 2 * np.pi, 49)
    radius = PLATE_MARGIN * routing_radius_m(mechanism)
    ring = np.stack([np.zeros_like(turn), radius * np.sin(turn), radius * np.cos(turn)], -1)
    for segment in range(mechanism.segment_count + 1):
        origin = joints[segment - 1] if segment else np.zeros(3)
        rotation = rotations[segment - 1] if segment else np.eye(3)
        for x in plate_positions_m(mechanism, segment):
            rim = origin + (ring + np.array([x, 0.0, 0.0])) @ rotation.T
            plate = Poly3DCollection([rim], facecolor=f"{_PLATE}2e", edgecolor=_PLATE, lw=0.8)
            plate.set_zorder(2)
            axes.add_collection3d(plate)
        if segment:
            tip = origin + rotation @ [mechanism.segment_length_m[segment - 1], 0.0, 0.0]
            axes.plot(*np.stack([origin, tip], -1), color="#5a667a", lw=6, zorder=3)
            axes.scatter(*origin, color="#bcc4d0", s=26, zorder=3)


def _draw_arrow(axes: Any, point: Array, contact: ShownContact, colour: str) -> None:
    """A shaft, and a zigzag between a cone's rim and its tip, so dense that it looks solid."""
    tail, tip = arrow_tail_m(point, contact.force_base_n, 0.0)
    along = unit(tip - tail)
    length = min(_HEAD_M, float(np.linalg.norm(tail - tip)))
    neck = tip - length * along
    axes.plot(*np.stack([tail, neck], -1), color=colour, lw=3.6, zorder=6)
    side = unit(np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0]))
    turn = np.linspace(0.0, 2 * np.pi, 40)[:, None]
    rim = neck + 0.3 * length * (np.cos(turn) * side + np.sin(turn) * np.cross(along, side))
    cone = np.stack([rim, np.broadcast_to(tip, rim.shape)], 1).reshape(-1, 3)
    axes.plot(*cone.T, color=colour, lw=1.2, zorder=6)


def _frame(axes: Any, mechanism: Mechanism) -> None:
    """No box around the arm: a scale of 0.1 m and the directions of the base axes suffice."""
    reach = float(mechanism.joint_position_straight_m[-1] + mechanism.segment_length_m[-1])
    low, high, half = -0.28 * reach, 1.14 * reach, 0.36 * reach
    axes.set(xlim=(low, high), ylim=(-half, half), zlim=(-half, half))
    axes.set_box_aspect((high - low, 2 * half, 2 * half), zoom=1.3)
    axes.set_proj_type("persp", focal_length=0.6)
    axes.view_init(elev=22, azim=-62)
    axes.set_axis_off()
    corner = np.array([0.0, -half, -0.8 * half])
    for name, way in zip("xyz", 0.1 * np.eye(3), strict=True):
        axes.quiver(*corner, *way, color=_DIM, lw=1.2, arrow_length_ratio=0.15)
        axes.text(*(corner + 1.18 * way), name, color=_DIM, ha="center", va="center")
    below = corner + np.array([0.05, -0.03, -0.02])
    axes.text(*below, "0.1 m", color=_DIM, size=9, ha="center", va="top")


def _draw_time(
    figure: Any, place: Any, record: PushRecord, segment_count: int, moment_s: float
) -> None:
    rows = place.subgridspec(3, 1, hspace=0.16, height_ratios=(1.3, 1, 1))
    force, angle, segment = (figure.add_subplot(rows[i]) for i in range(3))
    true = [snapshot.true for snapshot in record.snapshots]
    estimate = [
        snapshot.estimate if estimated else None
        for snapshot, estimated in zip(record.snapshots, record.estimated, strict=True)
    ]
    for contacts, rgb, kind, width in (
        (true, TRUE_RGB, "true", 4.5),
        (estimate, ESTIMATE_RGB, "estimated", 1.6),
    ):
        style = {"color": css(rgb), "lw": width, "solid_capstyle": "butt", "label": kind}
        for axes, name, none in (
            (force, "magnitude_n", 0.0),
            (angle, "angle_deg", np.nan),
            (segment, "segment", 0),
        ):
            values = [getattr(contact, name) if contact else none for contact in contacts]
            axes.plot(record.times_s, values, **style)
    force.set_ylabel("force, N")
    force.set_ylim(bottom=0.0)
    force.legend(loc="upper right", frameon=False, ncols=2, bbox_to_anchor=(1.0, 1.16))
    angle.set(ylabel="direction, °", ylim=(0, 360), yticks=(0, 90, 180, 270, 360))
    segment.set(
        ylabel="segment",
        yticks=range(segment_count + 1),
        yticklabels=["none", *map(str, range(1, segment_count + 1))],
        xlabel="time, s",
    )
    for row in (force, angle, segment):
        row.grid(visible=True, lw=0.6)
        row.axvline(moment_s, color=_DIM, lw=0.8, ls=":")
        row.set_xlim(0.0, record.times_s[-1])
        if row is not segment:
            row.tick_params(labelbottom=False)
    figure.align_ylabels((force, angle, segment))
    for number in range(1, segment_count + 1):
        segment.axhspan(number - 0.5, number + 0.5, color=css(segment_rgb(number)), alpha=0.06)
