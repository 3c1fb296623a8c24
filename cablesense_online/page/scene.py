"""The arm in 3D: cables coloured by tension, forces as arrows, the stated interval as lines."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from cablesense_base import Array
from cablesense_online.page import drawing
from cablesense_online.page.drawing import ESTIMATE_RGB, TRUE_RGB, Rgb
from cablesense_online.page.panel import newtons_text
from cablesense_online.page.snapshot import ShownContact, Snapshot
from cablesense_sim.kinematics import chain, joint_positions_m, segment_rotations
from cablesense_sim.mechanism import Mechanism

_CABLE_WIDTH, _INTERVAL_WIDTH, _PLATE_THICKNESS, _THINNEST_REGION = 0.008, 0.006, 0.0075, 0.006
_SHAFT_RADIUS, _HEAD_RADIUS, _HEAD_LENGTH = 0.0071, 0.018, 0.056
"""Shares of the arm's length."""
_SQUARES_M = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Sides that the squares of the ground may have."""
_BODY_SHARE = 0.34
"""Radius of the drawn body over that of the holes."""
_PLATE_RGB = (126, 138, 156)
_BODY_RGB = (70, 80, 98)
_JOINT_RGB = (188, 196, 208)
_POSE_DIGITS = 5
"""Joint angles, rad, are rounded to this many digits: smaller changes are not drawn."""
_ALONG_X = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""Quaternion, w x y z, that lays a cylinder, which stands on z, along x."""
_REGION_SHARE, _REGION_OPACITY = 1.35, 0.5
"""Radius of the band over that of the body."""
Touched = Callable[[int, int, float], None]
"""Takes a client, the segment, from 1, and the place on its axis, m from its joint centre."""
_Place = tuple[float, float, float]
_Anchor = Literal["center-center", "bottom-center", "top-center", "bottom-left", "bottom-right"]


class ArmScene:
    """The arm in a viser scene, made once; `show` moves and colours it."""

    def __init__(
        self,
        scene: viser.SceneApi,
        mechanism: Mechanism,
        arrows: drawing.Arrows,
        touched: Touched | None = None,
    ) -> None:
        """`touched` is called by a click on a segment."""
        self._arrows, reach_m = arrows, arrows.reach_m
        self._scene, self._mechanism, self._touched = scene, mechanism, touched
        self._pose_rad = np.zeros(mechanism.joint_count)
        self._radius_m = drawing.routing_radius_m(mechanism)
        self._clearance_m = 1.1 * _BODY_SHARE * self._radius_m
        square_m = min(_SQUARES_M, key=lambda side_m: abs(math.log(side_m / (0.1 * reach_m))))
        scene.add_grid(
            "/ground",
            width=6.0 * reach_m,
            height=6.0 * reach_m,
            cell_size=square_m,
            section_size=5.0 * square_m,
            cell_color=(46, 53, 65),
            section_color=(62, 72, 88),
            plane_color=(20, 23, 29),
            plane_opacity=1.0,
            fade_distance=5.0 * reach_m,
            position=(0.5 * reach_m, 0.0, -0.6 * reach_m),
        )
        scale, at = f"squares of {100.0 * square_m:g} cm", (0.65 * reach_m, -0.55 * reach_m, 0.0)
        self._add_label("/ground/scale", scale, at, "center-center")
        self._add_plates("/base", 0)
        self._add_label("/base/label", "base", (0.0, 0.0, 1.5 * self._radius_m), "bottom-center")
        numbers = range(1, mechanism.segment_count + 1)
        self._segments = [self._add_segment(n) for n in numbers]
        ends_m, self._piece_cable = drawing.cable_pieces(
            mechanism, np.zeros(mechanism.joint_count)
        )
        self._cables = scene.add_line_segments(
            "/cables",
            ends_m,
            np.full(ends_m.shape, 128, dtype=np.uint8),  # one colour would stay the only one
            thickness=_CABLE_WIDTH * reach_m,
        )
        self._interval = scene.add_line_segments(
            "/interval",
            np.zeros((drawing.INTERVAL_LINES, 2, 3)),
            np.tile(drawing.linear_rgb(np.array(ESTIMATE_RGB)), (drawing.INTERVAL_LINES, 2, 1)),
            thickness=_INTERVAL_WIDTH * reach_m,
            visible=False,
        )
        self._region = scene.add_cylinder(
            "/region",
            _REGION_SHARE * _BODY_SHARE * self._radius_m,
            color=ESTIMATE_RGB,
            opacity=_REGION_OPACITY,
            cast_shadow=False,
            visible=False,
        )
        self._true = _Forces(scene, mechanism, arrows, "true", TRUE_RGB, "bottom-right")
        self._estimated = _Forces(scene, mechanism, arrows, "est.", ESTIMATE_RGB, "bottom-left")

    def show(self, snapshot: Snapshot, full_scale_n: float) -> None:
        """Draws a moment; cables are coloured against the legend's full scale, N."""
        pose = np.round(snapshot.joint_angles_rad, _POSE_DIGITS)
        rotations = segment_rotations(self._mechanism, pose)
        turns = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
        joints_m = joint_positions_m(self._mechanism, pose)
        for frame, joint_m, turn in zip(self._segments, joints_m, turns, strict=True):
            frame.position, frame.wxyz = joint_m, turn
        ends_m, _ = drawing.cable_pieces(self._mechanism, pose)
        self._cables.points = ends_m.astype(np.float32)
        if snapshot.tensions_n is not None:
            rgb = drawing.linear_rgb(drawing.tension_rgb(snapshot.tensions_n, full_scale_n))
            self._cables.colors = np.repeat(rgb[self._piece_cable][:, None], 2, axis=1)
        self._pose_rad = pose
        axes, aside_m = rotations[:, :, 0], 0.5 * self._arrows.apart_m

        def points_m(contacts: Sequence[ShownContact], further_m: float) -> list[Array]:
            at = [(each.segment - 1, each.contact_m + further_m) for each in contacts]
            return [joints_m[n] + place_m * axes[n] for n, place_m in at]

        behind_m = points_m(snapshot.estimated, aside_m)
        self._true.show(snapshot.true, points_m(snapshot.true, -aside_m), self._clearance_m)
        self._estimated.show(snapshot.estimated, behind_m, self._clearance_m)
        strongest, bounds = next(iter(snapshot.estimated), None), snapshot.bounds
        self._interval.visible = bool(strongest and strongest.magnitude_n and bounds)
        if self._interval.visible and strongest and bounds:
            axis = axes[strongest.segment - 1]
            lines_m = drawing.interval_m(
                behind_m[0], axis, strongest, bounds, self._clearance_m, self._arrows
            )
            self._interval.points = lines_m.astype(np.float32)
        region = snapshot.region
        self._region.visible = region is not None
        if region is not None:
            n, low_m, high_m = region.segment - 1, region.low_m, region.high_m
            self._region.position = joints_m[n] + 0.5 * (low_m + high_m) * axes[n]
            lying = Rotation.from_quat(_ALONG_X, scalar_first=True)
            turn = Rotation.from_matrix(rotations[n]) * lying
            self._region.wxyz = turn.as_quat(scalar_first=True)
            self._region.scale = (
                1.0,
                1.0,
                max(high_m - low_m, _THINNEST_REGION * self._arrows.reach_m),
            )

    def _add_segment(self, segment: int) -> viser.FrameHandle:
        name, radius_m = f"/arm/segment_{segment}", _BODY_SHARE * self._radius_m
        frame = self._scene.add_frame(name, show_axes=False)
        self._scene.add_icosphere(f"{name}/joint", 0.62 * radius_m, _JOINT_RGB)
        length_m = float(self._mechanism.segment_length_m[segment - 1])
        offset_m = self._mechanism.plate_offset_m
        body_m = length_m - 2 * offset_m
        for part, thick_m, long_m in (
            ("neck", 0.45 * radius_m, length_m),
            ("body", radius_m, body_m),
        ):
            handle = self._add_disc(f"{name}/{part}", length_m / 2, thick_m, long_m, _BODY_RGB)
            if self._touched is not None:
                handle.on_click(partial(self._on_click, self._touched, segment))
        self._add_plates(name, segment)
        place_m = (float(self._mechanism.contact_m[segment - 1]), 0.0, -1.9 * self._radius_m)
        self._add_label(f"{name}/label", f"segment {segment}", place_m, "top-center")
        return frame

    def _on_click(self, touched: Touched, segment: int, event: Any) -> None:
        pose, n = chain(self._mechanism, self._pose_rad), segment - 1
        ray = np.array(event.ray_origin), np.array(event.ray_direction)
        place_m = drawing.place_m(pose.joint_m[n], pose.rotation[n, :, 0], *ray)
        if math.isfinite(place_m):
            touched(event.client_id, segment, place_m)

    def _add_plates(self, name: str, segment: int) -> None:
        radius_m = drawing.PLATE_MARGIN * self._radius_m
        opacity = 0.55 if segment else None
        thick_m = _PLATE_THICKNESS * self._arrows.reach_m
        for number, x_m in enumerate(drawing.plate_positions_m(self._mechanism, segment)):
            plate = f"{name}/plate_{number}"
            self._add_disc(plate, x_m, radius_m, thick_m, _PLATE_RGB, opacity)

    def _add_disc(
        self,
        name: str,
        x_m: float,
        radius_m: float,
        thickness_m: float,
        rgb: Rgb,
        opacity: float | None = None,
    ) -> viser.CylinderHandle:
        return self._scene.add_cylinder(
            name, radius_m, thickness_m, rgb, opacity=opacity, wxyz=_ALONG_X, position=(x_m, 0, 0)
        )

    def _add_label(self, name: str, text: str, place_m: _Place, anchor: _Anchor) -> None:
        self._scene.add_label(name, text, position=place_m, anchor=anchor, font_screen_scale=0.75)


class _Forces:
    """The arrows of one colour, with a label at each."""

    def __init__(
        self,
        scene: viser.SceneApi,
        mechanism: Mechanism,
        sizes: drawing.Arrows,
        name: str,
        rgb: Rgb,
        anchor: _Anchor,
    ) -> None:
        self._name, self._sizes = name, sizes
        self._arrows = scene.add_arrows(
            f"/forces/{name}",
            np.zeros((1, 2, 3)),
            drawing.linear_rgb(np.array(rgb)),
            shaft_radius=_SHAFT_RADIUS * sizes.reach_m,
            head_radius=_HEAD_RADIUS * sizes.reach_m,
            head_length=_HEAD_LENGTH * sizes.reach_m,
            visible=False,
        )
        self._labels = [
            scene.add_label(
                f"/forces/{name}/{number}",
                "",
                anchor=anchor,
                font_screen_scale=1.05,
                visible=False,
            )
            for number in range(1, mechanism.segment_count + 1)
        ]

    def show(
        self, contacts: Sequence[ShownContact], points_m: Sequence[Array], clearance_m: float
    ) -> None:
        """Shows these forces and no others, each at a point (3,) in the base frame."""
        arrows_m = [
            drawing.arrow_m(point_m, each.force_base_n, clearance_m, self._sizes)
            for each, point_m in zip(contacts, points_m, strict=True)
        ]
        if contacts:
            self._arrows.points = np.array(arrows_m, dtype=np.float32)
        self._arrows.visible = bool(contacts)
        for label in self._labels[len(contacts) :]:
            label.visible = False
        for label, contact, arrow_m in zip(self._labels, contacts, arrows_m, strict=False):
            label.position = arrow_m[0]
            label.text = f"{self._name} {newtons_text(contact.magnitude_n)} N"
            label.visible = True
