"""An arm of an arm file, as the page shows it."""

from __future__ import annotations

import math
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.felt import LinksAtPose
from cablesense_contact.felt_arm import FeltArm
from cablesense_msgs_py.messages import Load, read_load
from cablesense_msgs_py.topics import Frames
from cablesense_online.page.colours import Rgb
from cablesense_online.page.headline import Words
from cablesense_online.page.shown import (
    STEP_DEG,
    CommandSlider,
    Cylinder,
    DrawnPose,
    Extent,
    Label,
    ReadingPanel,
    Solid,
    Sphere,
)
from cablesense_online.page.snapshot import PlaceInterval
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import checked_command
from cablesense_sim.load_capacity import contact_range_n
from cablesense_sim.loads import contact_of_wrench
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.touch import touched_places

JOINT_LIMIT_DEG = 20.0
"""Largest angle that the sliders offer."""
_LEAST_SCALE_N = 100.0
"""Full scale of tensions, at least."""
_LEAST_FELT_N = 1e-3
"""Lateral force below which a load states no place."""
_PLATE_THICKNESS = 0.0075
"""Of a drawn guide plate, as a share of the arm's length."""
_PLATE_MARGIN = 1.18
"""Radius of a guide plate over that of its outermost hole."""
_PLATE_OPACITY = 0.55
"""Of guide plates other than the base's."""
_BODY_SHARE = 0.34
"""Radius of the drawn body over that of the holes."""
_NECK_SHARE = 0.45
"""Radius of the drawn neck between two segments over that of the body."""
_JOINT_SHARE = 0.62
"""Radius of a drawn joint over that of the body."""
_FLOOR_DEPTH = 0.6
"""Of the floor below the base, as a share of the arm's length."""
_MIDDLE = np.array([0.56, 0.0, -0.04])
"""Of the view, as a share of the arm's length."""
_PLATE_RGB: Rgb = (126, 138, 156)
_BODY_RGB: Rgb = (70, 80, 98)
_JOINT_RGB: Rgb = (188, 196, 208)


class ShownArm:
    """An arm on the page: a `shown.ShownMachine` whose bodies are the base and the segments."""

    def __init__(self, arm: Arm) -> None:
        mechanism = mechanism_of(arm)
        places = touched_places(arm)
        count = mechanism.segment_count
        self._mechanism = mechanism
        self.felt = FeltArm(arm)
        self.words = Words("arm", "segment", tuple(str(n) for n in range(1, count + 1)))
        self.sliders = _sliders(arm, mechanism)
        segments = mechanism.cable_segment.tolist()
        self.panels = (
            ReadingPanel(
                quantity="tension",
                unit="N",
                channels=tuple(range(arm.cable_count)),
                names=tuple(arm.cable_names),
                groups=tuple(f"segment {segment}" for segment in segments),
                order="by the segment that a cable ends on",
                least=_LEAST_SCALE_N,
            ),
        )
        self.strongest_n = contact_range_n(arm)
        self.touched_m: Array = places.touched_m
        self.unobstructed_m: Array = np.maximum(places.touched_m, mechanism.plate_offset_m)
        self.usual_m: Array = mechanism.contact_m
        hole_m = routing_radius_m(mechanism)
        self.surface_m = np.full(count, _BODY_SHARE * hole_m)
        length_m = float(mechanism.joint_position_straight_m[-1] + mechanism.segment_length_m[-1])
        self.extent = Extent(length_m * _MIDDLE, length_m, -_FLOOR_DEPTH * length_m)
        self.bodies = ("/base", *(f"/arm/segment_{n}" for n in range(1, count + 1)))
        self.solids = _solids(mechanism, hole_m, _PLATE_THICKNESS * length_m)
        above_base = Label("base", 0, (0.0, 0.0, 1.5 * hole_m), "bottom-center")
        self.labels = (above_base, *_segment_labels(mechanism, hole_m))
        straight = np.zeros(mechanism.joint_count)
        self.piece_channel = cable_pieces(mechanism, self.links_at(straight))[1]
        self._segment_ends_m = np.concatenate([[0.0], np.cumsum(mechanism.segment_length_m)])

    def pose_of(self, command: Array) -> Array:
        """(2N,) the commanded angles."""
        return command

    def command_near(self, turn_rad: Array) -> Array:
        """(2N,) these angles, from the straight arm."""
        return turn_rad

    def drawn_at(self, pose: Array) -> DrawnPose:
        """The arm at joint angles (2N,)."""
        links = self.links_at(pose)
        return DrawnPose(
            body_m=np.vstack([np.zeros((1, 3)), links.origin_m]),
            body_axes=np.concatenate([np.eye(3)[None], links.axes]),
            piece_m=cable_pieces(self._mechanism, links)[0],
            links=links,
        )

    def links_at(self, pose: Array) -> LinksAtPose:
        """The segments at joint angles (2N,)."""
        return self.felt.links_at(pose)

    def checked_command(self, command: Array) -> Array:
        """Joint angles (2N,) at which no guide plates touch.

        Raises:
            EquilibriumError: they do, or a number is not finite.
        """
        return checked_command(self._mechanism, command)

    def read_load(self, message: Any, frames: Frames, pose: Array) -> Load:
        """The load of a message in the frame of the base, or of a segment without torque.

        Raises:
            CableSenseError: see `messages.read_load` and `contact_of_wrench`.
        """
        contact_of = partial(contact_of_wrench, self._mechanism, pose, self.touched_m)
        return read_load(message, frames, contact_of)

    def load_frame(self, load: Load, frames: Frames, pose: Array) -> tuple[str, Array]:
        """The segment's frame for a load at its contact point, else the base's and the torque.

        A load of no lateral force has no place.
        """
        n = load.segment - 1
        links = self.links_at(pose)
        axis = links.axes[n, :, 0]
        lateral_n = float(np.linalg.norm(np.cross(axis, load.force_base_n)))
        is_usual = load.contact_m is None or load.contact_m == self.usual_m[n]
        if is_usual or lateral_n < _LEAST_FELT_N:
            return frames.segment(load.segment), np.zeros(3)
        point_m = links.origin_m[n] + (load.contact_m or 0.0) * axis
        return frames.base, np.cross(point_m, load.force_base_n)

    def covered(self, link: int, low_m: float, high_m: float) -> tuple[PlaceInterval, ...]:
        """Beyond a segment's ends an interval goes straight on along its neighbours."""
        from_base_m = float(self._segment_ends_m[link - 1])
        parts = []
        for n, (begin_m, end_m) in enumerate(pairwise(self._segment_ends_m.tolist()), start=1):
            # the ends of the arm are as good as what lies beyond them
            first_m = min(max(from_base_m + low_m, begin_m), end_m)
            last_m = min(max(from_base_m + high_m, begin_m), end_m)
            if last_m > first_m or n == link:
                parts.append(PlaceInterval(n, first_m - begin_m, last_m - begin_m))
        return tuple(parts)


def joint_limit_deg(mechanism: Mechanism) -> float:
    """Range of the sliders: no guide plates touch with both axes of a joint at its end."""
    of_one_axis_deg = math.degrees(float(mechanism.bend_limit_rad.min())) / math.sqrt(2.0)
    return min(JOINT_LIMIT_DEG, math.floor(2.0 * of_one_axis_deg) / 2.0)


def _sliders(arm: Arm, mechanism: Mechanism) -> tuple[CommandSlider, ...]:
    limit_deg = joint_limit_deg(mechanism)
    labels = [
        f"joint {1 + n // 2} {'yaw' if n % 2 else 'pitch'}, °" for n in range(arm.joint_count)
    ]
    return tuple(
        CommandSlider(label, -limit_deg, limit_deg, STEP_DEG, 0.0, math.degrees(1.0))
        for label in labels
    )


def routing_radius_m(mechanism: Mechanism) -> float:
    """The largest distance of a guide hole from the axis: all drawn parts follow it."""
    return float(np.hypot(mechanism.hole_y_m, mechanism.hole_z_m).max())


def plate_positions_m(mechanism: Mechanism, segment: int) -> list[float]:
    """Places of the guide plates of a segment (1 … N; 0 is the base) along its own x axis."""
    if segment == 0:
        return [0.0]
    length = float(mechanism.segment_length_m[segment - 1])
    return [mechanism.plate_offset_m, length - mechanism.plate_offset_m]


def _solids(mechanism: Mechanism, hole_m: float, thick_m: float) -> tuple[Solid, ...]:
    plate = Cylinder(_PLATE_MARGIN * hole_m, thick_m)
    radius_m = _BODY_SHARE * hole_m
    joint = Sphere(_JOINT_SHARE * radius_m)
    solids = [Solid("plate_0", 0, plate, _PLATE_RGB)]
    for segment in range(1, mechanism.segment_count + 1):
        length_m = float(mechanism.segment_length_m[segment - 1])
        body = Cylinder(radius_m, length_m - 2.0 * mechanism.plate_offset_m)
        neck = Cylinder(_NECK_SHARE * radius_m, length_m)
        middle = (0.5 * length_m, 0.0, 0.0)
        solids += [
            Solid("joint", segment, joint, _JOINT_RGB),
            Solid("neck", segment, neck, _BODY_RGB, middle, link=segment),
            Solid("body", segment, body, _BODY_RGB, middle, link=segment),
        ]
        solids += [
            Solid(f"plate_{n}", segment, plate, _PLATE_RGB, (x_m, 0.0, 0.0), _PLATE_OPACITY)
            for n, x_m in enumerate(plate_positions_m(mechanism, segment))
        ]
    return tuple(solids)


def _segment_labels(mechanism: Mechanism, hole_m: float) -> list[Label]:
    return [
        Label(f"segment {n}", n, (float(contact_m), 0.0, -1.9 * hole_m), "top-center")
        for n, contact_m in enumerate(mechanism.contact_m, start=1)
    ]


def cable_pieces(mechanism: Mechanism, links: LinksAtPose) -> tuple[Array, NDArray[np.int64]]:
    """The straight pieces of all cables, from actuator to anchor through the guide holes.

    Returns:
        Both ends (P, 2, 3) of each piece, base frame, and the position (P,) of its cable.
    """
    ends: list[tuple[Array, Array]] = []
    for cable, last_segment in enumerate(mechanism.cable_segment):
        y = mechanism.hole_y_m[cable]
        z = mechanism.hole_z_m[cable]
        points = [np.array([-mechanism.run_m, y, z]), np.array([0.0, y, z])]
        for n in range(1, last_segment + 1):
            plates_m = plate_positions_m(mechanism, n)
            for x in plates_m[:1] if n == last_segment else plates_m:
                points.append(links.origin_m[n - 1] + links.axes[n - 1] @ np.array([x, y, z]))
        ends += pairwise(points)
    pieces_of_cable = 2 * mechanism.cable_segment
    return np.array(ends), np.repeat(np.arange(mechanism.cable_count), pieces_of_cable)
