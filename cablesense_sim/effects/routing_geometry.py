"""Guide holes on another radius or at another angle."""

from __future__ import annotations

from cablesense_sim.effects.effect import Effect, OneArm, Parameter, chosen, own_cables
from cablesense_sim.mechanism import Mechanism, with_cables_moved, with_plates_moved


class RoutingGeometry(Effect):
    """Holes of a segment: those of the cables that end on it, or those in the plates it carries.

    The actuators still hold the lengths of the arm as it was drawn.
    """

    name = "routing_geometry"
    acts_on = "arm"
    about = "guide holes on another radius or at another angle"
    source = "Walker, Hannan: A novel elephant's trunk robot, AIM 1999: cable routing kinematics"
    sites = ("segment",)
    advice = "Measure radius and angle of these holes."
    parameters = (
        Parameter("cables_radius_m", "m", -0.03, 0.05, 0.002, "further out, its own cables"),
        Parameter("cables_angle_rad", "rad", -0.6, 0.6, 0.04, "turned, its own cables"),
        Parameter("plates_radius_m", "m", -0.03, 0.05, 0.002, "further out, in its plates"),
        Parameter("plates_angle_rad", "rad", -0.6, 0.6, 0.04, "turned, in its plates"),
    )

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        own = own_cables(place, mechanism)
        carried = chosen(place, mechanism.segment_count)
        if values["cables_radius_m"] or values["cables_angle_rad"]:
            mechanism = with_cables_moved(
                mechanism, own * values["cables_radius_m"], own * values["cables_angle_rad"]
            )
        if values["plates_radius_m"] or values["plates_angle_rad"]:
            mechanism = with_plates_moved(
                mechanism,
                carried * values["plates_radius_m"],
                carried * values["plates_angle_rad"],
            )
        return mechanism
