"""What a careful workshop leaves: no two arms are exactly alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cablesense_gap.plant.body import Body
from cablesense_gap.plant.real_arm import RealArm

MASS_SHARE = 0.005
PRETENSION_N = 0.15
CONTACT_M = 0.0003
HOLE_DEG = 0.05
ZERO_N = 0.05


def scattered(arm: RealArm, rng: np.random.Generator) -> RealArm:
    """The arm with normal deviations of one sigma each, as the constants of this module say.

    A cable's holes share their error, as those of a drilling template do.
    """
    body, cables = arm.body, arm.body.cable_count
    masses = body.mass_kg * (1.0 + MASS_SHARE * rng.standard_normal(len(body.mass_kg)))
    contact = body.contact_at_m.copy()
    contact[:, 0] += CONTACT_M * rng.standard_normal(len(contact))
    body = replace(
        body,
        mass_kg=masses,
        pretension_n=body.pretension_n + PRETENSION_N * rng.standard_normal(cables),
        contact_at_m=contact,
    )
    turned = turned_holes(body, np.deg2rad(HOLE_DEG) * rng.standard_normal(cables))
    zeros = arm.sensing.offset_n + ZERO_N * rng.standard_normal(cables)
    return replace(arm, body=turned, sensing=replace(arm.sensing, offset_n=zeros))


def turned_holes(body: Body, by_rad: np.ndarray) -> Body:
    """The body with the holes of each cable turned about the axis by angles (M,), +z to +y."""
    return replace(
        body, before_m=turned(body.before_m, by_rad), after_m=turned(body.after_m, by_rad)
    )


def turned(points_m: np.ndarray, by_rad: np.ndarray) -> np.ndarray:
    """Points (..., 3) turned about x, from +z towards +y."""
    sine, cosine = np.sin(by_rad), np.cos(by_rad)
    x, y, z = np.moveaxis(points_m, -1, 0)
    return np.stack([x, cosine * y + sine * z, cosine * z - sine * y], axis=-1)
