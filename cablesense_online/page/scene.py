"""The 3D scene: the arm with its cables coloured by tension, both forces as arrows."""

from __future__ import annotations

from typing import Literal

import numpy as np
import trimesh
import viser
from scipy.spatial.transform import Rotation

from cablesense_base.arrays import Array
from cablesense_online.page import drawing
from cablesense_online.page.drawing import (
    ARROWS_APART_M,
    ESTIMATE_RGB,
    TRUE_RGB,
    Rgb,
    arrow_tail_m,
    cable_pieces,
    linear_rgb,
    quaternion_z_to,
    tension_rgb,
)
from cablesense_online.page.live_arm import Contact
from cablesense_sim.kinematics import contact_points_m, joint_positions_m, segment_rotations
from cablesense_sim.mechanism import Mechanism

HEAD_LENGTH_M = 0.034
SHAFT_RADIUS_M = 0.0055


class _ForceArrow:
    """One arrow of the scene, moved rather than made anew, so that nothing flickers."""

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        rgb: Rgb,
        label_anchor: Literal["bottom-left", "bottom-right"],
    ) -> None:
        self._root = scene.add_frame(name, show_axes=False, visible=False)
        self._shaft, self._head = (
            scene.add_mesh_simple(
                f"{name}/{part}",
                mesh.vertices,
                mesh.faces,
                color=rgb,
                cast_shadow=False,
                receive_shadow=False,
            )
            for part, mesh in drawing.unit_arrow().items()
        )
        self._label = scene.add_label(
            f"{name}/label", "", anchor=label_anchor, font_screen_scale=1.05, visible=True
        )
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
        tail, tip = arrow_tail_m(contact_m, force_n, clearance_m)
        length = float(np.linalg.norm(tip - tail))
        head = min(HEAD_LENGTH_M, 0.6 * length)
        self._root.position = tail
        self._root.wxyz = quaternion_z_to(np.asarray(force_n, dtype=float))
        self._shaft.scale = (SHAFT_RADIUS_M, SHAFT_RADIUS_M, length - head)
        self._head.position = np.array([0.0, 0.0, length - head])
        self._head.scale = (2.3 * SHAFT_RADIUS_M, 2.3 * SHAFT_RADIUS_M, head)
        self._label.text = label
        self._root.visible = True
        self._shown = shown


CABLE_WIDTH_M = 0.0042
PLATE_RGB = (126, 138, 156)
BODY_RGB = (70, 80, 98)
JOINT_RGB = (188, 196, 208)
GROMMET_RGB = (28, 32, 40)
GROUND_RGB = (20, 23, 29)
POSE_STEP_RAD = 2e-5
"""Joint angles that differ by less are the same picture."""


class ArmScene:
    """The arm in a viser scene, made once; `pose`, `tensions` and `forces` move and colour it."""

    def __init__(self, scene: viser.SceneApi, mechanism: Mechanism) -> None:
        self._mechanism = mechanism
        self._clearance_m = 1.1 * drawing.BODY_SHARE * drawing.routing_radius_m(mechanism)
        self._pose_rad: Array | None = None
        self._contacts_m = np.zeros((mechanism.segment_count, 3))
        self._rotations = np.zeros((mechanism.segment_count, 3, 3))
        self._add_ground(scene)
        self._segments = [
            self._add_segment(scene, n) for n in range(1, mechanism.segment_count + 1)
        ]
        self._add_base(scene)
        straight = np.zeros(mechanism.joint_count)
        pieces = cable_pieces(
            mechanism,
            joint_positions_m(mechanism, straight),
            segment_rotations(mechanism, straight),
        )
        self._piece_cable = pieces.cable
        self._colours = np.full((len(pieces.cable), 2, 3), 128, dtype=np.uint8)
        self._cables = scene.add_line_segments(
            "/cables", pieces.ends_m, self._colours, thickness=CABLE_WIDTH_M
        )
        self._true = _ForceArrow(scene, "/forces/true", TRUE_RGB, "bottom-right")
        self._estimate = _ForceArrow(scene, "/forces/estimate", ESTIMATE_RGB, "bottom-left")
        self.pose(straight)

    def pose(self, joint_angles_rad: Array) -> None:
        """Moves the arm; (2N,) joint angles."""
        before = self._pose_rad
        if before is not None and np.abs(joint_angles_rad - before).max() < POSE_STEP_RAD:
            return
        self._pose_rad = np.array(joint_angles_rad, dtype=float)
        positions = joint_positions_m(self._mechanism, self._pose_rad)
        self._rotations = rotations = segment_rotations(self._mechanism, self._pose_rad)
        self._contacts_m = contact_points_m(self._mechanism, self._pose_rad)
        turns = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
        for frame, position, turn in zip(self._segments, positions, turns, strict=True):
            frame.position = position
            frame.wxyz = turn
        pieces = cable_pieces(self._mechanism, positions, rotations)
        self._cables.points = pieces.ends_m.astype(np.float32)

    def tensions(self, tensions_n: Array, full_scale_n: float) -> None:
        """Colours the cables; (M,) in N, against the legend's full scale."""
        of_cable = linear_rgb(tension_rgb(tensions_n, full_scale_n))
        colours = np.repeat(of_cable[self._piece_cable][:, None, :], 2, axis=1)
        if not np.array_equal(colours, self._colours):
            self._colours = colours
            self._cables.colors = colours

    def forces(self, true: Contact | None, estimate: Contact | None) -> None:
        """Shows the true and the estimated force, or hides what is None."""
        for arrow, contact, label, aside_m in (
            (self._true, true, "true", -ARROWS_APART_M / 2),
            (self._estimate, estimate, "estimated", ARROWS_APART_M / 2),
        ):
            if contact is None or contact.magnitude_n <= 0.0:
                arrow.hide()
            else:
                along = self._rotations[contact.segment - 1][:, 0]
                arrow.show(
                    self._contacts_m[contact.segment - 1] + aside_m * along,
                    contact.force_base_n,
                    self._clearance_m,
                    f"{label} {contact.magnitude_n:.1f} N at {contact.angle_deg:.0f}°",
                )

    def _add_ground(self, scene: viser.SceneApi) -> None:
        scene.add_grid(
            "/ground",
            width=3.0,
            height=3.0,
            plane="xy",
            cell_size=0.05,
            section_size=0.25,
            cell_color=(46, 53, 65),
            section_color=(62, 72, 88),
            plane_color=GROUND_RGB,
            plane_opacity=1.0,
            shadow_opacity=0.35,
            fade_distance=2.6,
            fade_strength=1.2,
            position=(0.25, 0.0, -0.32),
        )
        _add_label(scene, "/ground/scale", "squares of 5 cm", (0.35, -0.3, 0.0), "center-center")

    def _add_base(self, scene: viser.SceneApi) -> None:
        _add_part(scene, "/base/plate", drawing.plates(self._mechanism, 0), PLATE_RGB)
        _add_part(scene, "/base/grommets", drawing.grommets(self._mechanism, 0), GROMMET_RGB)
        height_m = 1.5 * drawing.routing_radius_m(self._mechanism)
        _add_label(scene, "/base/label", "base", (0.0, 0.0, height_m), "bottom-center")

    def _add_segment(self, scene: viser.SceneApi, segment: int) -> viser.FrameHandle:
        name = f"/arm/segment_{segment}"
        frame = scene.add_frame(name, show_axes=False)
        mechanism = self._mechanism
        _add_part(scene, f"{name}/body", drawing.body(mechanism, segment), BODY_RGB)
        _add_part(scene, f"{name}/joint", drawing.joint(mechanism), JOINT_RGB)
        _add_part(scene, f"{name}/plates", drawing.plates(mechanism, segment), PLATE_RGB, 0.55)
        _add_part(scene, f"{name}/grommets", drawing.grommets(mechanism, segment), GROMMET_RGB)
        depth_m = -1.9 * drawing.routing_radius_m(mechanism)
        place_m = (float(mechanism.contact_m[segment - 1]), 0.0, depth_m)
        _add_label(scene, f"{name}/label", f"segment {segment}", place_m, "top-center")
        return frame


def _add_part(
    scene: viser.SceneApi, name: str, mesh: trimesh.Trimesh, rgb: Rgb, opacity: float | None = None
) -> None:
    if len(mesh.vertices):
        scene.add_mesh_simple(
            name, mesh.vertices, mesh.faces, color=rgb, opacity=opacity, side="double"
        )


def _add_label(
    scene: viser.SceneApi,
    name: str,
    text: str,
    place_m: tuple[float, float, float],
    anchor: Literal["center-center", "bottom-center", "top-center"],
) -> None:
    scene.add_label(name, text, position=place_m, anchor=anchor, font_screen_scale=0.75)
