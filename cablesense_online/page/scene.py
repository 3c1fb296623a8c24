"""The arm in 3D: cables coloured by tension, forces as arrows, the stated interval as a wedge."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Literal

import numpy as np
import trimesh
import viser
from scipy.spatial.transform import Rotation

from cablesense_base import Array
from cablesense_online.page import drawing, panel
from cablesense_online.page.drawing import ESTIMATE_RGB, TRUE_RGB, Rgb
from cablesense_online.page.live_arm import ForceBounds, ShownContact
from cablesense_sim.kinematics import contact_points_m, joint_positions_m, segment_rotations
from cablesense_sim.mechanism import Mechanism

_HEAD_LENGTH_M = 0.034
_SHAFT_RADIUS_M = 0.0055
_CABLE_WIDTH_M = 0.0042
_PLATE_RGB = (126, 138, 156)
_BODY_RGB = (70, 80, 98)
_JOINT_RGB = (188, 196, 208)
_GROMMET_RGB = (28, 32, 40)
_GROUND_RGB = (20, 23, 29)
_Anchor = Literal["center-center", "bottom-center", "top-center", "bottom-left", "bottom-right"]
_WEDGE_STEP_M = 5e-4
_POSE_STEP_RAD = 2e-5
"""Joint angles that differ by less are the same picture."""


class ArmScene:
    """The arm in a viser scene, made once; `pose`, `tensions` and `forces` move and colour it."""

    def __init__(self, scene: viser.SceneApi, mechanism: Mechanism) -> None:
        self._scene = scene
        self._mechanism = mechanism
        self._clearance_m = 1.1 * drawing.BODY_SHARE * drawing.routing_radius_m(mechanism)
        self._pose_rad: Array | None = None
        self._add_ground_and_base()
        self._segments = [self._add_segment(n) for n in range(1, mechanism.segment_count + 1)]
        straight = np.zeros(mechanism.joint_count)
        positions = joint_positions_m(mechanism, straight)
        rotations = segment_rotations(mechanism, straight)
        ends_m, self._piece_cable = drawing.cable_pieces(mechanism, positions, rotations)
        self._colours = np.full((len(ends_m), 2, 3), 128, dtype=np.uint8)
        self._cables = scene.add_line_segments(
            "/cables", ends_m, self._colours, thickness=_CABLE_WIDTH_M
        )
        self._true = _ForceArrows(scene, "/forces/true", TRUE_RGB, "bottom-right")
        self._estimated = _ForceArrows(scene, "/forces/estimate", ESTIMATE_RGB, "bottom-left")
        self._interval = scene.add_mesh_simple(
            "/forces/interval",
            np.zeros((drawing.INTERVAL_FACES.max() + 1, 3)),
            drawing.INTERVAL_FACES,
            color=ESTIMATE_RGB,
            opacity=0.25,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self.pose(straight)

    def pose(self, joint_angles_rad: Array) -> None:
        """Moves the arm; (2N,) joint angles."""
        before = self._pose_rad
        if before is not None and np.abs(joint_angles_rad - before).max() < _POSE_STEP_RAD:
            return
        self._pose_rad = pose = np.array(joint_angles_rad, dtype=float)
        positions = joint_positions_m(self._mechanism, pose)
        self._rotations = rotations = segment_rotations(self._mechanism, pose)
        self._contacts_m = contact_points_m(self._mechanism, pose)
        turns = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
        for frame, position, turn in zip(self._segments, positions, turns, strict=True):
            frame.position = position
            frame.wxyz = turn
        ends_m, _ = drawing.cable_pieces(self._mechanism, positions, rotations)
        self._cables.points = ends_m.astype(np.float32)

    def tensions(self, tensions_n: Array, full_scale_n: float) -> None:
        """Colours the cables; (M,) in N, against the legend's full scale."""
        of_cable = drawing.linear_rgb(drawing.tension_rgb(tensions_n, full_scale_n))
        colours = np.repeat(of_cable[self._piece_cable][:, None, :], 2, axis=1)
        if not np.array_equal(colours, self._colours):
            self._colours = colours
            self._cables.colors = colours

    def forces(self, true: Sequence[ShownContact], estimated: Sequence[ShownContact]) -> None:
        """Shows these true and estimated forces, and no others."""
        for arrows, contacts, label, aside_m in (
            (self._true, true, "true", -drawing.ARROWS_APART_M / 2),
            (self._estimated, estimated, "est.", drawing.ARROWS_APART_M / 2),
        ):
            arrows.hide_but({contact.segment for contact in contacts})
            for contact in contacts:
                along = self._rotations[contact.segment - 1][:, 0]
                arrows[contact.segment].show(
                    self._contacts_m[contact.segment - 1] + aside_m * along,
                    contact.force_base_n,
                    self._clearance_m,
                    f"{label} {panel.force_text(contact.magnitude_n)}",
                )

    def interval(self, estimate: ShownContact | None, bounds: ForceBounds | None) -> None:
        """Shows the stated 95 % intervals of an estimate as the wedge that its arrow begins in."""
        if estimate is None or bounds is None:
            self._interval.visible = False
            return
        turns_deg = (-180.0, 180.0)
        if bounds.angles_deg is not None:
            first, last = bounds.angles_deg
            turns_deg = (
                -((estimate.angle_deg - first) % 360.0),
                (last - estimate.angle_deg) % 360.0,
            )
        along = self._rotations[estimate.segment - 1][:, 0]
        corners_m = drawing.interval_wedge_m(
            self._contacts_m[estimate.segment - 1] + drawing.ARROWS_APART_M / 2 * along,
            estimate.force_base_n,
            along,
            self._clearance_m,
            (bounds.low_n, bounds.high_n),
            (math.radians(turns_deg[0]), math.radians(turns_deg[1])),
        )
        if np.abs(corners_m - self._interval.vertices).max() > _WEDGE_STEP_M:
            self._interval.vertices = corners_m.astype(np.float32)
        self._interval.visible = True

    def _add_ground_and_base(self) -> None:
        self._scene.add_grid(
            "/ground",
            width=3.0,
            height=3.0,
            plane="xy",
            cell_size=0.05,
            section_size=0.25,
            cell_color=(46, 53, 65),
            section_color=(62, 72, 88),
            plane_color=_GROUND_RGB,
            plane_opacity=1.0,
            shadow_opacity=0.25,
            fade_distance=2.6,
            fade_strength=1.2,
            position=(0.25, 0.0, -0.32),
        )
        self._add_label("/ground/scale", "squares of 5 cm", (0.35, -0.3, 0.0), "center-center")
        self._add_part("/base/plate", drawing.plates(self._mechanism, 0), _PLATE_RGB)
        self._add_part("/base/grommets", drawing.grommets(self._mechanism, 0), _GROMMET_RGB)
        height_m = 1.5 * drawing.routing_radius_m(self._mechanism)
        self._add_label("/base/label", "base", (0.0, 0.0, height_m), "bottom-center")

    def _add_segment(self, segment: int) -> viser.FrameHandle:
        name, mechanism = f"/arm/segment_{segment}", self._mechanism
        radius_m = drawing.routing_radius_m(mechanism)
        frame = self._scene.add_frame(name, show_axes=False)
        joint = trimesh.creation.icosphere(
            subdivisions=3, radius=0.62 * drawing.BODY_SHARE * radius_m
        )
        self._add_part(f"{name}/body", drawing.body(mechanism, segment), _BODY_RGB)
        self._add_part(f"{name}/joint", joint, _JOINT_RGB)
        self._add_part(f"{name}/plates", drawing.plates(mechanism, segment), _PLATE_RGB, 0.55)
        self._add_part(f"{name}/grommets", drawing.grommets(mechanism, segment), _GROMMET_RGB)
        place_m = (float(mechanism.contact_m[segment - 1]), 0.0, -1.9 * radius_m)
        self._add_label(f"{name}/label", f"segment {segment}", place_m, "top-center")
        return frame

    def _add_part(
        self, name: str, mesh: trimesh.Trimesh, rgb: Rgb, opacity: float | None = None
    ) -> None:
        if len(mesh.vertices):
            self._scene.add_mesh_simple(
                name, mesh.vertices, mesh.faces, color=rgb, opacity=opacity, side="double"
            )

    def _add_label(
        self, name: str, text: str, place_m: tuple[float, float, float], anchor: _Anchor
    ) -> None:
        self._scene.add_label(name, text, position=place_m, anchor=anchor, font_screen_scale=0.75)


class _ForceArrows(dict[int, "_ForceArrow"]):
    """The arrows of one colour by segment, each made when it is first needed."""

    def __init__(self, scene: viser.SceneApi, name: str, rgb: Rgb, label: _Anchor) -> None:
        super().__init__()
        self._scene, self._name, self._look = scene, name, (rgb, label)

    def __missing__(self, segment: int) -> _ForceArrow:
        self[segment] = _ForceArrow(self._scene, f"{self._name}/{segment}", *self._look)
        return self[segment]

    def hide_but(self, segments: Collection[int]) -> None:
        for segment, arrow in self.items():
            if segment not in segments:
                arrow.hide()


class _ForceArrow:
    """One arrow of the scene, moved rather than made anew, so that nothing flickers."""

    def __init__(self, scene: viser.SceneApi, name: str, rgb: Rgb, label: _Anchor) -> None:
        self._root = scene.add_frame(name, show_axes=False, visible=False)
        self._shaft, self._head = (
            scene.add_mesh_simple(
                f"{name}/{part}",
                mesh.vertices,
                mesh.faces,
                color=rgb,
                scale=1e-3,  # else the first arrow fills the view until its size has come
                cast_shadow=False,
                receive_shadow=False,
            )
            for part, mesh in drawing.unit_arrow().items()
        )
        self._label = scene.add_label(f"{name}/label", "", anchor=label, font_screen_scale=1.05)
        self._shown: tuple[float, ...] | None = None

    def hide(self) -> None:
        if self._shown is not None:
            self._root.visible = False
            self._shown = None

    def show(self, contact_m: Array, force_n: Array, clearance_m: float, label: str) -> None:
        """Points the arrow at a contact (3,); base frame, the force (3,) in N and not zero."""
        shown = tuple(np.round(np.concatenate([contact_m, force_n]), 3))
        if shown == self._shown:
            return
        tail, tip = drawing.arrow_tail_m(contact_m, force_n, clearance_m)
        length = float(np.linalg.norm(tip - tail))
        head = min(_HEAD_LENGTH_M, 0.6 * length)
        self._root.position = tail
        self._root.wxyz = drawing.quaternion_z_to(np.asarray(force_n, dtype=float))
        self._shaft.scale = (_SHAFT_RADIUS_M, _SHAFT_RADIUS_M, length - head)
        self._head.position = np.array([0.0, 0.0, length - head])
        self._head.scale = (2.3 * _SHAFT_RADIUS_M, 2.3 * _SHAFT_RADIUS_M, head)
        self._label.text = label
        self._root.visible = True
        self._shown = shown
