"""Guide holes on another radius or at another angle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cablesense_sim.effects.effect import Array, Effect, Parameter, chosen, segments

if TYPE_CHECKING:
    from cablesense_sim.mechanism import Mechanism


class RoutingGeometry(Effect):
    """Holes of a segment: those of the cables that end on it, or those in the plates it carries.

    The actuators still hold the lengths of the arm as it was drawn.
    """

    name = "routing_geometry"
    acts_on = "arm"
    about = "a segment's guide holes on another radius or at another angle"
    source = "Walker, Hannan: A novel elephant's trunk robot, AIM 1999: cable routing kinematics"
    parameters = (
        Parameter("cables_radius_m", "m", -0.03, 0.05, 0.002, "further out, its own cables"),
        Parameter("cables_angle_rad", "rad", -0.6, 0.6, 0.04, "turned, its own cables"),
        Parameter("plates_radius_m", "m", -0.03, 0.05, 0.002, "further out, in its plates"),
        Parameter("plates_angle_rad", "rad", -0.6, 0.6, 0.04, "turned, in its plates"),
    )

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        return segments(segment_count)

    def amend(
        self, mechanism: Mechanism, place: str, values: Mapping[str, float]
    ) -> Mechanism:
        own = mechanism.cable_segment == int(place.rsplit("_", 1)[1])
        y, z = moved_holes_m(
            (mechanism.hole_y_m, mechanism.hole_z_m),
            own * values["cables_radius_m"],
            own * values["cables_angle_rad"],
        )
        held = (y, z)
        carried = mechanism.segment_hole_y_m, mechanism.segment_hole_z_m
        if carried[0] is not None and carried[1] is not None:
            held = carried
            held = moved_holes_m(
                held,
                own[:, None] * values["cables_radius_m"],
                own[:, None] * values["cables_angle_rad"],
            )
        if values["plates_radius_m"] == 0.0 and values["plates_angle_rad"] == 0.0:
            kept = held if carried[0] is not None else (None, None)
            return replace(
                mechanism, hole_y_m=y, hole_z_m=z, segment_hole_y_m=kept[0], segment_hole_z_m=kept[1]
            )
        shape = (mechanism.cable_count, mechanism.segment_count)
        every = tuple(np.broadcast_to(a if a.ndim == 2 else a[:, None], shape) for a in held)
        plates = chosen(place, mechanism.segment_count)
        y_plates, z_plates = moved_holes_m(
            (every[0], every[1]),
            plates * values["plates_radius_m"],
            plates * values["plates_angle_rad"],
        )
        return replace(
            mechanism,
            hole_y_m=y,
            hole_z_m=z,
            segment_hole_y_m=y_plates,
            segment_hole_z_m=z_plates,
        )


def moved_holes_m(
    holes_m: tuple[Array, Array], outward_m: Array, turned_rad: Array
) -> tuple[Array, Array]:
    """Holes (y, z) moved outward and turned from +z towards +y."""
    radius = np.hypot(*holes_m) + outward_m
    angle = np.arctan2(*holes_m) + turned_rad
    return radius * np.sin(angle), radius * np.cos(angle)
