"""Effects that change the arm itself: geometry, masses, stiffness and pretension."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cablesense_sim.effects.effect import Effect, OneArm, Parameter, chosen, own_cables, shape
from cablesense_sim.mechanism import (
    LEAST_PRETENSION_N,
    Mechanism,
    with_cables_moved,
    with_plates_moved,
)
from cablesense_sim.rotations import rotation_matrix

_LIGHTEST_SEGMENT_KG = 1e-9
"""Mass of a segment, at least: its centre is a ratio of two moments."""


class BaseTilt(Effect):
    """Gravity that points elsewhere in the base frame; loads are known in the base frame."""

    name = "base_tilt"
    acts_on = "arm"
    about = "a base that is not level"
    source = "Siciliano et al., Robotics: Modelling, Planning and Control, 2009, section 7.3"
    advice = "Put a level on the base; level it, or keep the tilt in the arm file."
    parameters = (
        Parameter("roll_rad", "rad", -0.6, 0.6, 0.05, "of the base about its x axis"),
        Parameter("pitch_rad", "rad", -0.6, 0.6, 0.05, "of the base about its y axis"),
    )

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        pitch = rotation_matrix(np.array([0.0, values["pitch_rad"], 0.0]))
        roll = rotation_matrix(np.array([values["roll_rad"], 0.0, 0.0]))
        tilt = roll @ pitch
        return replace(mechanism, gravity_m_s2=tilt.T @ mechanism.gravity_m_s2)


class CableStiffness(Effect):
    """Another stiffness from command to anchor, of all cables or of those of one segment."""

    name = "cable_stiffness"
    acts_on = "arm"
    about = "cables of another stiffness than stated"
    source = "Feyrer, Wire Ropes, 2nd ed. 2015, section 2.2: rope elasticity modulus"
    sites = ("arm", "segment")
    advice = (
        "Measure a cable's stiffness on a bench, from command to anchor; look for another "
        "kind or length of cable, and for a soft anchor."
    )
    parameters = (
        Parameter(
            "change", "1", -0.8, 3.0, 0.2, "share by which the stiffness is higher", relative=True
        ),
    )

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        scale = np.where(own_cables(place, mechanism), 1.0 + values["change"], 1.0)
        in_series = mechanism.stiffness_n_m * scale
        cable = 1.0 / (1.0 / in_series - 1.0 / mechanism.actuator_stiffness_n_m)
        return replace(mechanism, stiffness_n_m=in_series, cable_stiffness_n_m=cable)


class ContactOffset(Effect):
    """Loads further along one segment's axis, or along every segment's, than is stated of them."""

    name = "contact_offset"
    acts_on = "arm"
    about = "loads that act elsewhere along the segment than stated"
    source = "Bicchi, Salisbury and Brock, Contact sensing from force measurements, IJRR 1993"
    sites = ("arm", "segment")
    advice = "Measure where the load was applied, from the segment's joint centre."
    parameters = (
        Parameter("offset_m", "m", -0.1, 0.1, 0.01, "away from the base, from the place stated"),
    )

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        moved = chosen(place, mechanism.segment_count) * values["offset_m"]
        return replace(mechanism, contact_m=mechanism.contact_m + moved)


class JointElasticity(Effect):
    """A spring in both axes of a joint, at rest where the arm is straight: a sheath, a bundle."""

    name = "joint_elasticity"
    acts_on = "arm"
    about = "joints that spring back"
    source = "Spong, Modeling and control of elastic joint robots, ASME JDSMC 1987"
    sites = ("arm", "joint")
    advice = "Look for a sheath, a hose or a bundle through the middle of the arm."
    parameters = (Parameter("stiffness_n_m_rad", "N·m/rad", -20.0, 200.0, 5.0, "of each axis"),)

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        spring = chosen(place, mechanism.segment_count) * values["stiffness_n_m_rad"]
        return replace(
            mechanism, joint_stiffness_n_m_rad=mechanism.joint_stiffness_n_m_rad + spring
        )


class Payload(Effect):
    """A point mass on a segment's axis: a tool, a camera, a hose."""

    name = "payload"
    acts_on = "arm"
    about = "mass that nobody modelled"
    source = "Featherstone, Rigid Body Dynamics Algorithms, 2008, section 2.13"
    sites = ("segment",)
    advice = "Weigh what was added there: tools, hoses, covers."
    parameters = (
        Parameter("mass_kg", "kg", -0.5, 10.0, 0.3, "of what the segment carries besides"),
        shape(
            "beyond_middle",
            "1",
            -0.5,
            0.5,
            0.3,
            "its distance beyond the segment's middle, as a share of the segment's length",
        ),
    )
    product = Parameter(
        "moment_kg_m",
        "kg·m",
        -np.inf,
        np.inf,
        0.03,
        "mass times distance from the segment's joint; of a mass on segment 1, all that shows",
    )

    def lever(self, mechanism: Mechanism, place: str, values: OneArm) -> float:
        length_m = mechanism.segment_length_m[chosen(place, mechanism.segment_count)]
        return float((0.5 + values["beyond_middle"]) * length_m[0])

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        affected = chosen(place, mechanism.segment_count)
        mass = mechanism.mass_kg + affected * values["mass_kg"]
        added = values["mass_kg"] * self.lever(mechanism, place, values)
        moment = mechanism.mass_kg * mechanism.centre_of_mass_m + affected * added
        heavy = np.maximum(mass, _LIGHTEST_SEGMENT_KG)
        return replace(mechanism, mass_kg=heavy, centre_of_mass_m=moment / heavy)


class PretensionError(Effect):
    """Cables whose tension, with the arm held straight, was set to another value.

    The arm moves until it is balanced again, so a single wrong cable changes all the others.
    """

    name = "pretension_error"
    acts_on = "arm"
    about = "cables tensioned to another value"
    source = "Pott, Cable-Driven Parallel Robots, 2018, section 3.7: force distribution"
    sites = ("arm", "cable")
    advice = "Tension these cables anew with the arm straight, or keep the values in the arm file."
    parameters = (
        Parameter("error_n", "N", -45.0, 200.0, 5.0, "by which the pretension is higher"),
    )

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        error = chosen(place, mechanism.cable_count) * values["error_n"]
        pretension = np.maximum(mechanism.pretension_n + error, LEAST_PRETENSION_N)
        return replace(mechanism, pretension_n=pretension)


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
        moved_cables = own_cables(place, mechanism)
        carried = chosen(place, mechanism.segment_count)
        if values["cables_radius_m"] or values["cables_angle_rad"]:
            mechanism = with_cables_moved(
                mechanism,
                moved_cables * values["cables_radius_m"],
                moved_cables * values["cables_angle_rad"],
            )
        if values["plates_radius_m"] or values["plates_angle_rad"]:
            mechanism = with_plates_moved(
                mechanism,
                carried * values["plates_radius_m"],
                carried * values["plates_angle_rad"],
            )
        return mechanism
