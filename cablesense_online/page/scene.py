"""The arm in 3D: cables coloured by tension, forces as arrows, the stated interval as lines."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import viser
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact
from cablesense_online.page.panel import newtons_text
from cablesense_online.page.snapshot import (
    ESTIMATE_RGB,
    TRUE_RGB,
    ForceBounds,
    PlaceInterval,
    Rgb,
    Snapshot,
    linear_rgb,
    tension_rgb,
)
from cablesense_sim.kinematics import chain, joint_positions_m, segment_rotations
from cablesense_sim.mechanism import Mechanism

_CABLE_WIDTH = 0.008
"""Of a drawn cable, as a share of the arm's length."""
_INTERVAL_WIDTH = 0.006
"""Of the line of an interval, as a share of the arm's length."""
_PLATE_THICKNESS = 0.0075
"""Of a drawn guide plate, as a share of the arm's length."""
_THINNEST_REGION = 0.006
"""Of the band of a contact's place, as a share of the arm's length."""
_SHAFT_RADIUS = 0.0071
"""Of an arrow, as a share of the arm's length."""
_HEAD_RADIUS = 0.018
"""Of an arrow's head, as a share of the arm's length."""
_HEAD_LENGTH = 0.056
"""Of an arrow's head, as a share of the arm's length."""
_FLOOR_DEPTH = 0.6
"""Of the floor below the base, as a share of the arm's length."""
_AXES_LENGTH = 0.2
"""Of the base frame's drawn axes, as a share of the arm's length."""
_AXES_RADIUS = 0.006
"""Of these axes, as a share of the arm's length."""
_SQUARES_M = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Sides that the squares of the ground may have."""
_BODY_SHARE = 0.34
"""Radius of the drawn body over that of the holes."""
_PLATE_RGB = (126, 138, 156)
"""Colour of guide plates."""
_BODY_RGB = (70, 80, 98)
"""Colour of segments."""
_JOINT_RGB = (188, 196, 208)
"""Colour of joints."""
_POSE_DIGITS = 5
"""Joint angles, rad, are rounded to this many digits: smaller changes are not drawn."""
_ALONG_X = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""Quaternion, w x y z, that lays a cylinder, which stands on z, along x."""
_REGION_SHARE = 1.35
"""Radius of the band of a contact's place, over that of the body."""
_REGION_OPACITY = 0.5
"""Of this band: the body stays visible."""


@dataclass(frozen=True)
class Mouse:
    """What a browser's mouse does on the arm.

    Attributes:
        touched: by a click. Takes a client, the segment, from 1, and the place on its axis, m from
            its joint centre.
        pulled: by a drag. Takes a client and the contact whose force the drag stands for; None at
            its end.
    """

    touched: Callable[[int, int, float], None]
    pulled: Callable[[int, Contact | None], None]


_Place = tuple[float, float, float]
_Anchor = Literal["center-center", "bottom-center", "top-center", "bottom-left", "bottom-right"]


PLATE_MARGIN = 1.18
"""Radius of a guide plate over that of its outermost hole."""


@dataclass(frozen=True)
class Arrows:
    """Sizes of the arrows: that of `strongest_n` is 3/4 of `reach_m`, the length of the arm."""

    reach_m: float
    strongest_n: float

    def length_m(self, magnitude_n: ArrayLike) -> Array:
        """Within what can be seen and fits the view."""
        share = 0.75 * np.asarray(magnitude_n) / self.strongest_n
        return self.reach_m * np.clip(share, 0.1, 0.85)

    @property
    def newtons_per_m(self) -> float:
        """The force of a metre, as far as arrows are neither the shortest nor the longest."""
        return self.strongest_n / (0.75 * self.reach_m)

    @property
    def apart_m(self) -> float:
        """Distance of true and estimated arrow along the segment: neither hides the other."""
        return 0.015 * self.reach_m


def routing_radius_m(mechanism: Mechanism) -> float:
    """The largest distance of a guide hole from the axis: all drawn parts follow it."""
    return float(np.hypot(mechanism.hole_y_m, mechanism.hole_z_m).max())


def plate_positions_m(mechanism: Mechanism, segment: int) -> list[float]:
    """Places of the guide plates of a segment (1 … N; 0 is the base) along its own x axis."""
    if segment == 0:
        return [0.0]
    length = float(mechanism.segment_length_m[segment - 1])
    return [mechanism.plate_offset_m, length - mechanism.plate_offset_m]


def cable_pieces(mechanism: Mechanism, joint_angles_rad: Array) -> tuple[Array, NDArray[np.int64]]:
    """The straight pieces of all cables, from actuator to anchor through the guide holes.

    Returns:
        Both ends (P, 2, 3) of each piece, base frame, and the position (P,) of its cable.
    """
    joints_m = joint_positions_m(mechanism, joint_angles_rad)
    rotations = segment_rotations(mechanism, joint_angles_rad)
    ends: list[tuple[Array, Array]] = []
    for cable, last_segment in enumerate(mechanism.cable_segment):
        y = mechanism.hole_y_m[cable]
        z = mechanism.hole_z_m[cable]
        points = [np.array([-mechanism.run_m, y, z]), np.array([0.0, y, z])]
        for n in range(1, last_segment + 1):
            plates_m = plate_positions_m(mechanism, n)
            for x in plates_m[:1] if n == last_segment else plates_m:
                points.append(joints_m[n - 1] + rotations[n - 1] @ np.array([x, y, z]))
        ends += pairwise(points)
    pieces_each = 2 * mechanism.cable_segment
    return np.array(ends), np.repeat(np.arange(mechanism.cable_count), pieces_each)


def unit(vector: Array) -> Array:
    """The unit vector along a vector that is not zero."""
    return np.asarray(vector / np.linalg.norm(vector))


def arrow_m(contact_m: Array, force_n: Array, clearance_m: float, arrows: Arrows) -> Array:
    """Tail and tip (2, 3) of the arrow that pushes on a contact.

    It points at the arm and ends `clearance_m` before its axis.
    """
    direction = unit(force_n)
    tip = contact_m - clearance_m * direction
    return np.stack([tip - arrows.length_m(np.linalg.norm(force_n)) * direction, tip])


INTERVAL_LINES = 66
"""Half of them for each arc."""


def interval_m(
    contact_m: Array,
    normal: Array,
    force_n: Array,
    angle_deg: float,
    bounds: ForceBounds,
    clearance_m: float,
    arrows: Arrows,
) -> Array:
    """Lines (L, 2, 3) around the places where the arrow of a force within `bounds` may begin.

    It turns in the plane with the `normal` (3,), the axis of the segment. The lines begin at the
    arrow of the estimated force (3,), at its contact angle; its part along the axis is left out.
    The others as in `arrow_m`.
    """
    ahead = unit(force_n - (force_n @ normal) * normal)
    aside = np.cross(ahead, normal)  # contact angles grow from +z to +y, against the axis' screw
    first_deg, last_deg = bounds.angles_deg or (0.0, 360.0)
    width_deg = (last_deg - first_deg) % 360.0 if bounds.angles_deg else 360.0
    turn = np.deg2rad(first_deg - angle_deg + np.linspace(0.0, width_deg, INTERVAL_LINES // 2))
    rays = np.outer(np.cos(turn), ahead) + np.outer(np.sin(turn), aside)
    near, far = (
        contact_m - (clearance_m + arrows.length_m(end_n)) * rays
        for end_n in (bounds.low_n, bounds.high_n)
    )
    outline = np.concatenate([near, far[::-1], near[:1]])
    return np.stack([outline[:-1], outline[1:]], axis=1)


def place_m(joint_m: Array, axis: Array, ray_origin: Array, ray_direction: Array) -> float:
    """Distance from a joint centre of the point on a segment's axis that is nearest to a ray.

    All are (3,) in one frame; the axis is a unit vector. The distance is NaN along the axis.
    """
    ahead = unit(ray_direction)
    aside = axis - (axis @ ahead) * ahead
    with np.errstate(invalid="ignore", divide="ignore"):
        return float((ray_origin - joint_m) @ aside / (aside @ axis))


def pulled_contact(
    segment: int, joint_m: Array, axis: Array, at_command: Array, ends_m: Array, arrows: Arrows
) -> Contact:
    """The contact that pulls a segment, 1 … N, from one point to another.

    Args:
        segment: that is pulled.
        joint_m: (3,) its joint centre, base frame, as the following ones.
        axis: (3,) of the segment, a unit vector.
        at_command: (3, 3) its rotation at the commanded pose, in whose axes contacts are.
        ends_m: (2, 3) where the segment is held, and where to.
        arrows: say how many newtons a length is.
    """
    (held_m, towards_m) = ends_m
    force_n = arrows.newtons_per_m * (towards_m - held_m)
    place_m = float((held_m - joint_m) @ axis)
    return Contact.of_force(segment, (force_n @ at_command).tolist(), place_m)


VIEW_ANGLE_RAD = 0.75
"""Height of the view."""
_SIDE_VIEW = np.array([0.36, -1.66, 0.74])
"""From the point that the camera looks at to the camera, in lengths of the arm."""
_TALL = 0.6
"""The view of a phone, upright: its lower part is under the panel."""


def view(reach_m: float, aspect: float) -> tuple[Array, Array]:
    """Camera position and the point that it looks at, (3,) each, to see an arm of a reach.

    `aspect` is the view's width over its height.
    """
    look_at = reach_m * np.array([0.56, 0.0, -0.04])
    from_there = reach_m * _SIDE_VIEW * max(1.0, 1.05 / max(aspect, 0.2))
    if aspect < _TALL:
        half_height_m = float(np.linalg.norm(from_there)) * math.tan(0.5 * VIEW_ANGLE_RAD)
        look_at = look_at - np.array([0.0, 0.0, 0.55 * half_height_m])
    return look_at + from_there, look_at


class ArmScene:
    """The arm in a viser scene, made once; `show` moves and colours it."""

    def __init__(
        self,
        scene: viser.SceneApi,
        mechanism: Mechanism,
        arrows: Arrows,
        mouse: Mouse | None = None,
    ) -> None:
        """Without a `mouse` the arm is only shown."""
        self._arrows = arrows
        reach_m = arrows.reach_m
        self._scene = scene
        self._mechanism = mechanism
        self._mouse = mouse
        self._dragging: set[int] = set()  # clients
        self._pose_rad = np.zeros(mechanism.joint_count)
        self._command_rad = self._pose_rad
        self._radius_m = routing_radius_m(mechanism)
        self._clearance_m = 1.1 * _BODY_SHARE * self._radius_m
        square_m = min(_SQUARES_M, key=lambda side_m: abs(math.log(side_m / (0.1 * reach_m))))
        floor_m = -_FLOOR_DEPTH * reach_m
        scene.add_grid(
            "/ground",
            width=6.0 * reach_m,
            height=6.0 * reach_m,
            cell_size=square_m,
            section_size=5.0 * square_m,
            cell_color=(70, 79, 95),
            section_color=(116, 129, 150),
            plane_color=(38, 43, 52),
            plane_opacity=1.0,
            fade_distance=8.0 * reach_m,
            position=(0.5 * reach_m, 0.0, floor_m),
        )
        scale = f"squares of {100.0 * square_m:g} cm"
        scale_at_m = (0.65 * reach_m, -0.55 * reach_m, 0.0)
        self._add_label("/ground/scale", scale, scale_at_m, "center-center")
        self._add_axes(floor_m)
        self._add_plates("/base", 0)
        self._add_label("/base/label", "base", (0.0, 0.0, 1.5 * self._radius_m), "bottom-center")
        numbers = range(1, mechanism.segment_count + 1)
        self._segments = [self._add_segment(n) for n in numbers]
        ends_m, self._piece_cable = cable_pieces(mechanism, np.zeros(mechanism.joint_count))
        self._cables = scene.add_line_segments(
            "/cables",
            ends_m,
            np.full(ends_m.shape, 128, dtype=np.uint8),  # one colour would stay the only one
            thickness=_CABLE_WIDTH * reach_m,
        )
        self._interval = scene.add_line_segments(
            "/interval",
            np.zeros((INTERVAL_LINES, 2, 3)),
            np.tile(linear_rgb(np.array(ESTIMATE_RGB)), (INTERVAL_LINES, 2, 1)),
            thickness=_INTERVAL_WIDTH * reach_m,
            visible=False,
        )
        self._region = [
            scene.add_cylinder(
                f"/region/segment_{n}",
                _REGION_SHARE * _BODY_SHARE * self._radius_m,
                color=ESTIMATE_RGB,
                opacity=_REGION_OPACITY,
                cast_shadow=False,
                visible=False,
            )
            for n in numbers
        ]
        self._true = _Forces(scene, mechanism, arrows, "true", TRUE_RGB, "bottom-right")
        self._estimated = _Forces(scene, mechanism, arrows, "est.", ESTIMATE_RGB, "bottom-left")

    def show(self, snapshot: Snapshot, full_scale_n: float) -> None:
        """Draws a moment; cables are coloured against the legend's full scale, N."""
        pose = np.round(snapshot.joint_angles_rad, _POSE_DIGITS)
        rotations = segment_rotations(self._mechanism, pose)
        turns = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
        joints_m = joint_positions_m(self._mechanism, pose)
        for frame, joint_m, turn in zip(self._segments, joints_m, turns, strict=True):
            frame.position = joint_m
            frame.wxyz = turn
        ends_m, _ = cable_pieces(self._mechanism, pose)
        self._cables.points = ends_m.astype(np.float32)
        if snapshot.tensions_n is not None:
            rgb = linear_rgb(tension_rgb(snapshot.tensions_n, full_scale_n))
            self._cables.colors = np.repeat(rgb[self._piece_cable][:, None], 2, axis=1)
        self._pose_rad = pose
        self._command_rad = snapshot.command_rad
        axes = rotations[:, :, 0]
        aside_m = 0.5 * self._arrows.apart_m
        at_command = segment_rotations(self._mechanism, snapshot.command_rad)

        def forces(contacts: Sequence[Contact], further_m: float) -> list[tuple[Array, Array]]:
            """Points and forces (3,) of contacts in the base frame, so much further along."""
            pushes = []
            for contact in contacts:
                n = contact.segment - 1
                point_m = joints_m[n] + (contact.contact_m + further_m) * axes[n]
                pushes.append((point_m, at_command[n] @ contact.wrench[:3]))
            return pushes

        behind = forces(snapshot.estimated, aside_m)
        self._true.show(snapshot.true, forces(snapshot.true, -aside_m), self._clearance_m)
        self._estimated.show(snapshot.estimated, behind, self._clearance_m)
        strongest = next(iter(snapshot.estimated), None)
        bounds = snapshot.bounds
        self._interval.visible = bool(strongest and strongest.magnitude_n and bounds)
        if self._interval.visible and strongest and bounds:
            (point_m, force_n) = behind[0]
            axis = axes[strongest.segment - 1]
            angle_deg = strongest.angle_deg
            clearance_m = self._clearance_m
            lines_m = interval_m(
                point_m, axis, force_n, angle_deg, bounds, clearance_m, self._arrows
            )
            self._interval.points = lines_m.astype(np.float32)
        self._show_region(snapshot.region, joints_m, rotations)

    def _show_region(
        self, region: Sequence[PlaceInterval], joints_m: Array, rotations: Array
    ) -> None:
        """A band around what an interval of places covers of each segment."""
        lying = Rotation.from_quat(_ALONG_X, scalar_first=True)
        thinnest_m = _THINNEST_REGION * self._arrows.reach_m
        covered = {part.segment: part for part in region}
        for n, band in enumerate(self._region):
            part = covered.get(n + 1)
            band.visible = part is not None
            if part is None:
                continue
            middle_m = 0.5 * (part.low_m + part.high_m)
            band.position = joints_m[n] + middle_m * rotations[n, :, 0]
            turn = Rotation.from_matrix(rotations[n]) * lying
            band.wxyz = turn.as_quat(scalar_first=True)
            band.scale = (1.0, 1.0, max(part.high_m - part.low_m, thinnest_m))

    def _add_axes(self, floor_m: float) -> None:
        """The axes of the base frame, on the floor below the base, where nothing hides them."""
        length_m = _AXES_LENGTH * self._arrows.reach_m
        self._scene.add_frame(
            "/axes",
            axes_length=length_m,
            axes_radius=_AXES_RADIUS * self._arrows.reach_m,
            position=(0.0, 0.0, floor_m),
        )
        for axis, name in enumerate("xyz"):
            tip_m = np.zeros(3)
            tip_m[axis] = 1.15 * length_m
            (x_m, y_m, z_m) = tip_m.tolist()
            self._add_label(f"/axes/{name}", name, (x_m, y_m, z_m), "center-center")

    def _add_segment(self, segment: int) -> viser.FrameHandle:
        name = f"/arm/segment_{segment}"
        radius_m = _BODY_SHARE * self._radius_m
        frame = self._scene.add_frame(name, show_axes=False)
        self._scene.add_icosphere(f"{name}/joint", 0.62 * radius_m, _JOINT_RGB)
        length_m = float(self._mechanism.segment_length_m[segment - 1])
        body_m = length_m - 2 * self._mechanism.plate_offset_m
        parts = (("neck", 0.45 * radius_m, length_m), ("body", radius_m, body_m))
        for part, thick_m, long_m in parts:
            handle = self._add_disc(f"{name}/{part}", length_m / 2, thick_m, long_m, _BODY_RGB)
            if self._mouse is not None:
                handle.on_click(partial(self._on_click, self._mouse, segment))
                handle.on_drag("left")(partial(self._on_drag, self._mouse, segment))
        self._add_plates(name, segment)
        place_m = (float(self._mechanism.contact_m[segment - 1]), 0.0, -1.9 * self._radius_m)
        self._add_label(f"{name}/label", f"segment {segment}", place_m, "top-center")
        return frame

    def _on_click(self, mouse: Mouse, segment: int, event: Any) -> None:
        pose = chain(self._mechanism, self._pose_rad)
        n = segment - 1
        ray = np.array(event.ray_origin), np.array(event.ray_direction)
        at_m = place_m(pose.joint_m[n], pose.rotation[n, :, 0], *ray)
        if math.isfinite(at_m):
            mouse.touched(event.client_id, segment, at_m)

    async def _on_drag(self, mouse: Mouse, segment: int, event: Any) -> None:
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
        pose = chain(self._mechanism, self._pose_rad)
        at_command = segment_rotations(self._mechanism, self._command_rad)
        n = segment - 1
        ends_m = np.array([event.start_position, event.end_position])
        contact = pulled_contact(
            segment, pose.joint_m[n], pose.rotation[n, :, 0], at_command[n], ends_m, self._arrows
        )
        mouse.pulled(client, contact)

    def _add_plates(self, name: str, segment: int) -> None:
        radius_m = PLATE_MARGIN * self._radius_m
        opacity = 0.55 if segment else None
        thick_m = _PLATE_THICKNESS * self._arrows.reach_m
        for number, x_m in enumerate(plate_positions_m(self._mechanism, segment)):
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
        sizes: Arrows,
        name: str,
        rgb: Rgb,
        anchor: _Anchor,
    ) -> None:
        self._name = name
        self._sizes = sizes
        self._arrows = scene.add_arrows(
            f"/forces/{name}",
            np.zeros((1, 2, 3)),
            linear_rgb(np.array(rgb)),
            shaft_radius=_SHAFT_RADIUS * sizes.reach_m,
            head_radius=_HEAD_RADIUS * sizes.reach_m,
            head_length=_HEAD_LENGTH * sizes.reach_m,
            visible=False,
        )
        look: Any = {"anchor": anchor, "font_screen_scale": 1.05, "visible": False}
        numbers = range(1, mechanism.segment_count + 1)
        self._labels = [scene.add_label(f"/forces/{name}/{n}", "", **look) for n in numbers]

    def show(
        self,
        contacts: Sequence[Contact],
        forces: Sequence[tuple[Array, Array]],
        clearance_m: float,
    ) -> None:
        """Shows these contacts and no others, each with its point and force in the base frame."""
        arrows_m = [
            arrow_m(point_m, force_n, clearance_m, self._sizes) for point_m, force_n in forces
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
