"""Meshes of the arm's rigid parts and of arrows, made once when the page starts."""

from __future__ import annotations

from typing import cast

import numpy as np
import trimesh

from cablesense_sim.mechanism import Mechanism

X_FROM_Z = trimesh.transformations.rotation_matrix(np.pi / 2, [0.0, 1.0, 0.0])
PLATE_THICKNESS_M = 0.004
PLATE_MARGIN = 1.18
BODY_SHARE = 0.34
HOLE_RADIUS_M = 0.0032


def routing_radius_m(mechanism: Mechanism) -> float:
    """The largest distance of a guide hole from the axis: all drawn parts follow it."""
    return float(np.hypot(mechanism.hole_y_m, mechanism.hole_z_m).max())


def _disc(x_m: float, radius_m: float, thickness_m: float) -> trimesh.Trimesh:
    disc = trimesh.creation.cylinder(radius_m, thickness_m, sections=48)
    disc.apply_transform(X_FROM_Z)
    disc.apply_translation([x_m, 0.0, 0.0])
    return disc


def _joined(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of many, so that the browser has one thing to draw."""
    return cast(trimesh.Trimesh, trimesh.util.concatenate(parts))


def plate_positions_m(mechanism: Mechanism, segment: int) -> list[float]:
    """Places of the guide plates of a segment (1 … N; 0 is the base) along its own x axis."""
    if segment == 0:
        return [0.0]
    length = float(mechanism.segment_length_m[segment - 1])
    return [mechanism.plate_offset_m, length - mechanism.plate_offset_m]


def plates(mechanism: Mechanism, segment: int) -> trimesh.Trimesh:
    """The guide plates of a segment, or the base plate for 0."""
    radius = PLATE_MARGIN * routing_radius_m(mechanism)
    positions = plate_positions_m(mechanism, segment)
    return _joined([_disc(x, radius, PLATE_THICKNESS_M) for x in positions])


def grommets(mechanism: Mechanism, segment: int) -> trimesh.Trimesh:
    """The rims of the holes that cables pass, in the plates of a segment."""
    rims = []
    for cable, last in enumerate(mechanism.cable_segment):
        for place, x in enumerate(plate_positions_m(mechanism, segment)):
            passes = last > segment if segment == 0 or place == 1 else last >= segment
            if passes:
                rim = _disc(x, HOLE_RADIUS_M, PLATE_THICKNESS_M * 1.5)
                rim.apply_translation([0, mechanism.hole_y_m[cable], mechanism.hole_z_m[cable]])
                rims.append(rim)
    return _joined(rims) if rims else trimesh.Trimesh()


def body(mechanism: Mechanism, segment: int) -> trimesh.Trimesh:
    """A segment's spine between its plates, with the necks that lead to its joints."""
    radius = BODY_SHARE * routing_radius_m(mechanism)
    length = float(mechanism.segment_length_m[segment - 1])
    offset = mechanism.plate_offset_m
    last = segment == mechanism.segment_count
    spine = _disc(length / 2, radius, length - 2 * offset)
    neck_end = length if last else length - 0.2 * offset
    neck = _disc((0.2 * offset + neck_end) / 2, 0.45 * radius, neck_end - 0.2 * offset)
    return _joined([spine, neck])


def joint(mechanism: Mechanism) -> trimesh.Trimesh:
    """A universal joint's cross in its ball."""
    radius = BODY_SHARE * routing_radius_m(mechanism)
    return trimesh.creation.icosphere(subdivisions=3, radius=0.62 * radius)


def unit_cylinder() -> trimesh.Trimesh:
    """Radius 1, from the origin to +z = 1: scaled into cable pieces and shafts."""
    cylinder = trimesh.creation.cylinder(1.0, 1.0, sections=12)
    cylinder.apply_translation([0.0, 0.0, 0.5])
    return cylinder


def unit_cone() -> trimesh.Trimesh:
    """Radius 1 at the origin, tip at +z = 1: scaled into arrow heads."""
    return trimesh.creation.cone(1.0, 1.0, sections=32)
