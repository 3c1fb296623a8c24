"""A force in the scene: an arrow that points at the arm, with a label at its tail."""

from __future__ import annotations

from typing import Literal

import numpy as np
import viser

from cablesense_ros.page import meshes
from cablesense_ros.page.colours import Rgb
from cablesense_ros.page.geometry import Array, arrow_tail_m, quaternion_z_to

HEAD_LENGTH_M = 0.034


class ForceArrow:
    """One arrow of the scene, moved rather than made anew, so that nothing flickers."""

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        rgb: Rgb,
        *,
        shaft_radius_m: float,
        label_anchor: Literal["bottom-left", "bottom-right"],
    ) -> None:
        self._radius_m = shaft_radius_m
        self._root = scene.add_frame(name, show_axes=False, visible=False)
        shaft, head = meshes.unit_cylinder(), meshes.unit_cone()
        self._shaft = scene.add_mesh_simple(
            f"{name}/shaft",
            shaft.vertices,
            shaft.faces,
            color=rgb,
            cast_shadow=False,
            receive_shadow=False,
        )
        self._head = scene.add_mesh_simple(
            f"{name}/head",
            head.vertices,
            head.faces,
            color=rgb,
            cast_shadow=False,
            receive_shadow=False,
        )
        self._label = scene.add_label(
            f"{name}/label", "", anchor=label_anchor, font_screen_scale=1.05, visible=True
        )
        self._shown: tuple[float, ...] | None = None

    def hide(self) -> None:
        """Takes the arrow out of sight."""
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
        self._shaft.scale = (self._radius_m, self._radius_m, length - head)
        self._head.position = np.array([0.0, 0.0, length - head])
        self._head.scale = (2.3 * self._radius_m, 2.3 * self._radius_m, head)
        self._label.text = label
        self._root.visible = True
        self._shown = shown
