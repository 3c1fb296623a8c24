"""Friction as drives have it, to be hidden in a robot; a cause's name is that of its law."""

from __future__ import annotations

import numpy as np

from cablesense_plants.cases import Draws, added, sets
from cablesense_plants.robot.causes import LISTED, RobotChange, RobotDraw, at_joints

FRICTION = Draws()


def _bristles(draw: RobotDraw, soft: tuple[float, float]) -> RobotChange:
    """Friction at one joint; bristles bend by a share of its reach."""
    weight = draw.weighted_joints(draw.alike, one=True)
    static = draw.uniform(0.5, 1.2)
    until = draw.speed * draw.uniform(0.08, 0.3)
    bends = draw.kind.reach_rad * draw.uniform(*soft)
    rough = sets(
        "bristles",
        coulomb_n_m=added(weight),
        static_share=np.full_like(weight, static),
        stribeck_rad_s=until,
        presliding_rad=bends,
        damping_s=np.full_like(weight, 1e-3),
    )
    joint = int(weight.argmax())
    details = {
        "static_share": static,
        "stribeck_rad_s": float(until[joint]),
        "presliding_rad": float(bends[joint]),
    }
    return RobotChange(rough, where=draw.named(weight), details=details)


@FRICTION.of_size("N·m", most=30.0)
def lugre(draw: RobotDraw) -> RobotChange:
    """Soft bristles, as of harmonic drives and cables, with Stribeck's fall."""
    return _bristles(draw, (0.004, 0.02))


@FRICTION.of_size("N·m", most=30.0)
def stribeck(draw: RobotDraw) -> RobotChange:
    """Hard bristles: bearings and seals."""
    return _bristles(draw, (2e-4, 5e-4))


FRICTION.of_size("1", most=0.4)(at_joints("proportional", one=True), "load_dependent")
FRICTION["coulomb"] = LISTED["joint_friction"]
