"""The machine in 3D: cables coloured by tension, forces as arrows, intervals as lines."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cablesense_base import Array
from cablesense_contact.felt import LinksAtPose
from cablesense_msgs_py.messages import Contact
from cablesense_online.page.arrows import CLEARANCE, ArrowScale, arrow_m, place_m, pulled_contact
from cablesense_online.page.colours import ESTIMATE_RGB, TRUE_RGB, Rgb, linear_rgb, piece_rgb
from cablesense_online.page.figures import newtons_text
from cablesense_online.page.marks import (
    BAND_OPACITY,
    BAND_SHARE,
    CABLE_WIDTH,
    FORCE_OUTLINE_LINES,
    FORCE_OUTLINE_WIDTH,
    interval_outline_m,
    place_band,
)
from cablesense_online.page.shown import (
    Cylinder,
    DrawnPose,
    Extent,
    Mesh,
    ShownMachine,
    Solid,
    Sphere,
)
from cablesense_online.page.snapshot import PlaceInterval, Snapshot

_SHAFT_RADIUS = 0.0071
"""Of an arrow, as a share of the machine's size, as the following ones."""
_HEAD_RADIUS = 0.018
"""Of an arrow's head."""
_HEAD_LENGTH = 0.056
"""Of an arrow's head."""
_AXES_LENGTH = 0.2
"""Of the base frame's drawn axes."""
_AXES_RADIUS = 0.006
"""Of these axes."""
_SQUARES_M = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Sides that the squares of the ground may have."""
_POSE_DIGITS = 5
"""Joint positions, rad or m, are rounded to this many digits: smaller changes are not drawn."""
_ALONG_X = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""Quaternion, w x y z, that lays a cylinder, which stands on z, along x."""


@dataclass(frozen=True)
class Mouse:
    """What a browser's mouse does on the machine.

    Attributes:
        touched: by a click. Takes a client, the link, from 1, and the place on its axis, m.
        pulled: by a drag. Takes a client and the contact whose force the drag stands for; None at
            its end.
    """

    touched: Callable[[int, int, float], None]
    pulled: Callable[[int, Contact | None], None]


_Place = tuple[float, float, float]
_Anchor = Literal["center-center", "bottom-center", "top-center", "bottom-left", "bottom-right"]


VIEW_ANGLE_RAD = 0.75
"""Height of the view."""
_SIDE_VIEW = np.array([0.36, -1.66, 0.74])
"""From the point that the camera looks at to the camera, in lengths of the machine."""
_TALL = 0.6
"""The view of a phone, upright: its lower part is under the panel."""


def view(extent: Extent, aspect: float) -> tuple[Array, Array]:
    """Camera position and the point that it looks at, (3,) each, to see a machine whole.

    `aspect` is the view's width over its height.
    """
    look_at = extent.look_at_m
    from_there = extent.size_m * _SIDE_VIEW * max(1.0, 1.05 / max(aspect, 0.2))
    if aspect < _TALL:
        half_height_m = float(np.linalg.norm(from_there)) * math.tan(0.5 * VIEW_ANGLE_RAD)
        look_at = look_at - np.array([0.0, 0.0, 0.55 * half_height_m])
    return look_at + from_there, look_at


class MachineScene:
    """A machine in a viser scene, made once; `show` moves and colours it."""

    def __init__(
        self,
        scene: viser.SceneApi,
        shown: ShownMachine,
        scale: ArrowScale,
        mouse: Mouse | None = None,
    ) -> None:
        """Without a `mouse` the machine is only shown."""
        self._scale = scale
        self._scene = scene
        self._shown = shown
        self._mouse = mouse
        self._dragging: set[int] = set()  # clients
        first_pose = shown.pose_of(shown.felt.first_command)
        drawn = shown.drawn_at(first_pose)
        self._links = drawn.links
        self._frame_axes = drawn.links.axes
        self._clearance_m = CLEARANCE * shown.surface_m
        self._add_ground()
        self._add_axes()
        self._bodies = [scene.add_frame(name, show_axes=False) for name in shown.bodies]
        for solid in shown.solids:
            self._add_solid(f"{shown.bodies[solid.body]}/{solid.name}", solid)
        for number, label in enumerate(shown.labels):
            name = f"{shown.bodies[label.body]}/label_{number}"
            self._add_label(name, label.text, label.position_m, label.anchor)
        self._cables = self._add_cables(drawn)
        self._force_outline = scene.add_line_segments(
            "/force_outline",
            np.zeros((FORCE_OUTLINE_LINES, 2, 3)),
            np.tile(linear_rgb(np.array(ESTIMATE_RGB)), (FORCE_OUTLINE_LINES, 2, 1)),
            thickness=FORCE_OUTLINE_WIDTH * scale.size_m,
            visible=False,
        )
        self._place_bands = [
            scene.add_cylinder(
                f"/place/{n}",
                BAND_SHARE * surface_m,
                color=ESTIMATE_RGB,
                opacity=BAND_OPACITY,
                cast_shadow=False,
                visible=False,
            )
            for n, surface_m in enumerate(shown.surface_m.tolist(), start=1)
        ]
        count = len(shown.words.links)
        self._true = _Forces(scene, count, scale, "true", TRUE_RGB, "bottom-right")
        self._estimated = _Forces(scene, count, scale, "est.", ESTIMATE_RGB, "bottom-left")

    def show(self, snapshot: Snapshot, full_scale_n: float) -> None:
        """Draws an instant; cables are coloured against the legend's full scale, N."""
        drawn = self._shown.drawn_at(np.round(snapshot.pose, _POSE_DIGITS))
        turns = Rotation.from_matrix(drawn.body_axes).as_quat(scalar_first=True)
        for frame, body_m, turn in zip(self._bodies, drawn.body_m, turns, strict=True):
            frame.position = body_m
            frame.wxyz = turn
        if self._cables is not None:
            self._cables.points = drawn.piece_m.astype(np.float32)
            if snapshot.readings is not None:
                self._cables.colors = self._cable_colours(snapshot.readings, full_scale_n)
        links = drawn.links
        self._links = links
        self._frame_axes = self._shown.links_at(snapshot.frame_pose).axes
        aside_m = 0.5 * self._scale.apart_m
        estimated = self._forces(snapshot.estimated, aside_m)
        self._true.show(snapshot.true, self._forces(snapshot.true, -aside_m), self._clearance_m)
        self._estimated.show(snapshot.estimated, estimated, self._clearance_m)
        strongest = next(iter(snapshot.estimated), None)
        bounds = snapshot.bounds
        self._force_outline.visible = bool(strongest and strongest.magnitude_n and bounds)
        if self._force_outline.visible and strongest and bounds:
            (point_m, force_n) = estimated[0]
            n = strongest.segment - 1
            lines_m = interval_outline_m(
                point_m,
                links.axes[n, :, 0],
                force_n,
                strongest.angle_deg,
                bounds,
                float(self._clearance_m[n]),
                self._scale,
            )
            self._force_outline.points = lines_m.astype(np.float32)
        self._show_place(snapshot.region, links)

    def _forces(self, contacts: Sequence[Contact], further_m: float) -> list[tuple[Array, Array]]:
        """Points and forces (3,) of contacts in the base frame, so much further along."""
        pushes = []
        for contact in contacts:
            n = contact.segment - 1
            along = self._links.axes[n, :, 0]
            point_m = self._links.origin_m[n] + (contact.contact_m + further_m) * along
            pushes.append((point_m, self._frame_axes[n] @ contact.wrench[:3]))
        return pushes

    def _cable_colours(self, readings: Array, full_scale_n: float) -> NDArray[np.uint8]:
        """(P, 2, 3) of the cables' pieces."""
        rgb = piece_rgb(readings, self._shown.piece_channel, full_scale_n)
        return np.repeat(linear_rgb(rgb)[:, None], 2, axis=1)

    def _show_place(self, region: Sequence[PlaceInterval], links: LinksAtPose) -> None:
        """A band around what an interval of places covers of each link."""
        lying = Rotation.from_quat(_ALONG_X, scalar_first=True)
        covered = {part.segment: part for part in region}
        for n, band in enumerate(self._place_bands):
            part = covered.get(n + 1)
            band.visible = part is not None
            if part is None:
                continue
            stated = place_band(part, self._scale.size_m)
            band.position = links.origin_m[n] + stated.middle_m * links.axes[n, :, 0]
            turn = Rotation.from_matrix(links.axes[n]) * lying
            band.wxyz = turn.as_quat(scalar_first=True)
            band.scale = (1.0, 1.0, stated.length_m)

    def _add_ground(self) -> None:
        size_m = self._scale.size_m
        floor_m = self._shown.extent.floor_m
        x_m, y_m, _ = self._shown.extent.look_at_m.tolist()
        square_m = min(_SQUARES_M, key=lambda side_m: abs(math.log(side_m / (0.1 * size_m))))
        self._scene.add_grid(
            "/ground",
            width=6.0 * size_m,
            height=6.0 * size_m,
            cell_size=square_m,
            section_size=5.0 * square_m,
            cell_color=(70, 79, 95),
            section_color=(116, 129, 150),
            plane_color=(38, 43, 52),
            plane_opacity=1.0,
            fade_distance=8.0 * size_m,
            position=(x_m, y_m, floor_m),
        )
        scale = f"squares of {100.0 * square_m:g} cm"
        place = (0.65 * size_m, -0.55 * size_m, 0.0)
        self._add_label("/ground/scale", scale, place, "center-center")

    def _add_axes(self) -> None:
        """The axes of the base frame, on the floor below the base, where nothing hides them."""
        length_m = _AXES_LENGTH * self._scale.size_m
        self._scene.add_frame(
            "/axes",
            axes_length=length_m,
            axes_radius=_AXES_RADIUS * self._scale.size_m,
            position=(0.0, 0.0, self._shown.extent.floor_m),
        )
        for axis, name in enumerate("xyz"):
            tip_m = np.zeros(3)
            tip_m[axis] = 1.15 * length_m
            (x_m, y_m, z_m) = tip_m.tolist()
            self._add_label(f"/axes/{name}", name, (x_m, y_m, z_m), "center-center")

    def _add_cables(self, drawn: DrawnPose) -> viser.LineSegmentsHandle | None:
        """None of a machine without."""
        if not len(drawn.piece_m):
            return None
        return self._scene.add_line_segments(
            "/cables",
            drawn.piece_m,
            np.full(
                drawn.piece_m.shape, 128, dtype=np.uint8
            ),  # one colour would stay the only one
            thickness=CABLE_WIDTH * self._scale.size_m,
        )

    def _add_solid(self, name: str, solid: Solid) -> None:
        look: Any = {"color": solid.rgb, "opacity": solid.opacity, "position": solid.position_m}
        handle: Any
        match solid.shape:
            case Sphere(radius_m):
                handle = self._scene.add_icosphere(name, radius_m, **look)
            case Cylinder(radius_m, length_m):
                handle = self._scene.add_cylinder(name, radius_m, length_m, wxyz=_ALONG_X, **look)
            case Mesh(vertices_m, faces):
                handle = self._scene.add_mesh_simple(name, vertices_m, faces, **look)
        if self._mouse is not None and solid.link:
            handle.on_click(partial(self._on_click, self._mouse, solid.link))
            handle.on_drag("left")(partial(self._on_drag, self._mouse, solid.link))

    def _on_click(self, mouse: Mouse, link: int, event: Any) -> None:
        n = link - 1
        ray = np.array(event.ray_origin), np.array(event.ray_direction)
        touched_m = place_m(self._links.origin_m[n], self._links.axes[n, :, 0], *ray)
        if math.isfinite(touched_m):
            mouse.touched(event.client_id, link, touched_m)

    async def _on_drag(self, mouse: Mouse, link: int, event: Any) -> None:
        """Not in a thread, where an update could overtake start or end."""
        client = event.client_id
        if event.phase == "start":
            self._dragging.add(client)
        elif client not in self._dragging:
            return
        if event.phase == "end":
            self._dragging.remove(client)
            mouse.pulled(client, None)
            return
        n = link - 1
        ends_m = np.array([event.start_position, event.end_position])
        contact = pulled_contact(
            link,
            self._links.origin_m[n],
            self._links.axes[n, :, 0],
            self._frame_axes[n],
            ends_m,
            self._scale,
        )
        mouse.pulled(client, contact)

    def _add_label(self, name: str, text: str, place_m: _Place, anchor: _Anchor) -> None:
        self._scene.add_label(name, text, position=place_m, anchor=anchor, font_screen_scale=0.75)


class _Forces:
    """The arrows of one colour, with a label at each."""

    def __init__(
        self,
        scene: viser.SceneApi,
        link_count: int,
        scale: ArrowScale,
        name: str,
        rgb: Rgb,
        anchor: _Anchor,
    ) -> None:
        self._name = name
        self._scale = scale
        self._arrows = scene.add_arrows(
            f"/forces/{name}",
            np.zeros((1, 2, 3)),
            linear_rgb(np.array(rgb)),
            shaft_radius=_SHAFT_RADIUS * scale.size_m,
            head_radius=_HEAD_RADIUS * scale.size_m,
            head_length=_HEAD_LENGTH * scale.size_m,
            visible=False,
        )
        look: Any = {"anchor": anchor, "font_screen_scale": 1.05, "visible": False}
        numbers = range(1, link_count + 1)
        self._labels = [scene.add_label(f"/forces/{name}/{n}", "", **look) for n in numbers]

    def show(
        self,
        contacts: Sequence[Contact],
        forces: Sequence[tuple[Array, Array]],
        clearance_m: Array,
    ) -> None:
        """Shows these contacts and no others, each with its point and force in the base frame.

        Arrows end so far (N,) before the axes of the links.
        """
        arrows_m = [
            arrow_m(point_m, force_n, float(clearance_m[contact.segment - 1]), self._scale)
            for contact, (point_m, force_n) in zip(contacts, forces, strict=True)
        ]
        if contacts:
            self._arrows.points = np.array(arrows_m, dtype=np.float32)
        self._arrows.visible = bool(contacts)
        for label in self._labels[len(contacts) :]:
            label.visible = False
        for label, contact, drawn_m in zip(self._labels, contacts, arrows_m, strict=False):
            label.position = drawn_m[0]
            label.text = f"{self._name} {newtons_text(contact.magnitude_n)} N"
            label.visible = True
