"""Scatter of built arms about their file, fitted beside every effect and never named as a cause.

Each class is what one part of an arm differs by. Its numbers are those of
`cablesense_sim.tolerances.ArmParameters`, with the same meaning, and a diagnosis takes their
standard deviations from the tolerances of the arm file; `typical` is that of a careful workshop.
They add the points where loads were applied, which belong to a recording, and a cable's own share
of the friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cablesense_base import Array
from cablesense_sim.effects.effect import (
    Effect,
    Instant,
    OneArm,
    Parameter,
    Sensing,
    Values,
    cables,
    chosen,
)
from cablesense_sim.mechanism import LEAST_CABLE_SHARE, LEAST_PRETENSION_N, Mechanism
from cablesense_sim.tolerances import Tolerances, displaced_m

_CAREFUL = Tolerances()
_TILT_RAD = float(np.deg2rad(_CAREFUL.base_tilt_deg))
_ZERO_RAD = float(np.deg2rad(_CAREFUL.joint_zero_deg))
_LAST = 1
"""Order among effects: tolerances act on the arm as other effects leave it."""


class CableTolerance(Effect):
    """Scatter of one cable's stiffness, pretension and friction."""

    name = "cable_tolerance"
    acts_on = "arm"
    about = "the tolerance of a cable"
    source = "Feyrer, Wire Ropes, 2nd ed. 2015, section 2.2: rope elasticity modulus"
    sites = ("cable",)
    order = _LAST
    version = 2  # before, it had the angle of its holes and the sensor's zero
    parameters = (
        Parameter(
            "log_stiffness",
            "1",
            -1.0,
            1.0,
            _CAREFUL.cable_stiffness_share,
            "logarithm of the ratio of its stiffness to the stated one",
        ),
        Parameter(
            "pretension_n", "N", -1e4, 1e4, _CAREFUL.pretension_n, "of the pretension, in excess"
        ),
        Parameter(
            "friction_share",
            "1",
            -0.9,
            2.0,
            _CAREFUL.friction_share,
            "of the friction at its guides, in excess",
        ),
    )
    tolerance = True

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        affected = chosen(place, mechanism.cable_count)
        tensioned = mechanism.pretension_n + affected * values["pretension_n"]
        if values["pretension_n"] < 0.0:
            tensioned = np.where(affected, np.maximum(tensioned, LEAST_PRETENSION_N), tensioned)
        friction = mechanism.relative_friction * (1.0 + affected * values["friction_share"])
        amended = replace(mechanism, pretension_n=tensioned, relative_friction=friction)
        if not values["log_stiffness"]:
            return amended
        in_series = mechanism.stiffness_n_m * np.exp(affected * values["log_stiffness"])
        by_cable = 1.0 / in_series - 1.0 / mechanism.actuator_stiffness_n_m
        alone = 1.0 / np.maximum(by_cable, LEAST_CABLE_SHARE / in_series)
        return replace(
            amended,
            stiffness_n_m=in_series,
            cable_stiffness_n_m=np.where(affected, alone, mechanism.cable_stiffness_n_m),
        )


class HoleTolerance(Effect):
    """Scatter of one guide hole: of a cable in the base plate (0), or in those of a segment.

    The actuators still hold the lengths of the arm as it was drawn.
    """

    name = "hole_tolerance"
    acts_on = "arm"
    about = "the tolerance of a guide hole"
    source = "ISO 2768-1, general tolerances, class m"
    order = _LAST
    parameters = (
        Parameter("outward_m", "m", -0.02, 0.02, _CAREFUL.hole_radial_m, "away from the axis"),
        Parameter(
            "around_m",
            "m",
            -0.02,
            0.02,
            _CAREFUL.hole_around_m,
            "around the axis, from +z towards +y",
        ),
    )
    tolerance = True

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        per_segment = cable_count // segment_count
        return tuple(
            f"{cable}_plate_{plate}"
            for i, cable in enumerate(cables(cable_count))
            for plate in range(i // per_segment + 2)
        )

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        return self.amend_all(mechanism, [(place, values)])

    def amend_all(
        self, mechanism: Mechanism, everywhere: Sequence[tuple[str, OneArm]]
    ) -> Mechanism:
        """All holes of an arm at once, which are many."""
        base_y = mechanism.hole_y_m.copy()
        base_z = mechanism.hole_z_m.copy()
        y = mechanism.segment_hole_y_m.copy()
        z = mechanism.segment_hole_z_m.copy()
        for place, values in everywhere:
            _, cable, _, plate = place.split("_")
            i = int(cable) - 1
            n = int(plate) - 1
            moved = np.array(values["outward_m"]), np.array(values["around_m"])
            if n < 0:
                base_y[i], base_z[i] = displaced_m(base_y[i], base_z[i], *moved)
            else:
                y[i, n], z[i, n] = displaced_m(y[i, n], z[i, n], *moved)
        return replace(
            mechanism, hole_y_m=base_y, hole_z_m=base_z, segment_hole_y_m=y, segment_hole_z_m=z
        )


class SensorTolerance(Effect):
    """Scatter of one channel's gain and zero; the zero is not scaled."""

    name = "sensor_tolerance"
    acts_on = "sensor"
    about = "the tolerance of a tension sensor"
    source = "JCGM 200:2012 (VIM) 4.12 and 4.28: sensitivity and zero error"
    sites = ("cable",)
    order = _LAST
    parameters = (
        Parameter(
            "gain",
            "1",
            -0.5,
            0.5,
            _CAREFUL.sensor_gain_share,
            "share by which readings are too high",
        ),
        Parameter("zero_n", "N", -1e4, 1e4, _CAREFUL.sensor_zero_n, "reading without a tension"),
    )
    tolerance = True

    def sensing(self, place: str, values: Values) -> Sensing:
        gain = 1.0 + values["gain"]
        zero_n = values["zero_n"]
        i = int(place.rsplit("_", 1)[1]) - 1

        def read(_: float | Array, tensions_n: Array) -> Array:
            reading_n = tensions_n.copy()
            reading_n[..., i] = gain * tensions_n[..., i] + zero_n
            return reading_n

        return Instant(read)


class SegmentTolerance(Effect):
    """Scatter of one segment's mass and lengths, and of the points at which it is loaded."""

    name = "segment_tolerance"
    acts_on = "arm"
    about = "the tolerance of a segment"
    source = "ISO 2768-1, general tolerances, classes f to m"
    sites = ("segment",)
    order = _LAST
    version = 2  # before, it had neither the centre of mass nor the length
    parameters = (
        Parameter(
            "mass_share", "1", -0.9, 2.0, _CAREFUL.segment_mass_share, "of the mass, in excess"
        ),
        Parameter(
            "centre_m",
            "m",
            -0.05,
            0.05,
            _CAREFUL.centre_of_mass_m,
            "of the centre of mass, outward",
        ),
        Parameter(
            "length_m",
            "m",
            -0.02,
            0.02,
            _CAREFUL.segment_length_m,
            "from joint centre to joint centre, in excess",
        ),
        Parameter("contact_m", "m", -0.02, 0.02, _CAREFUL.contact_m, "of loaded points, outward"),
    )
    tolerance = True

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        affected = chosen(place, mechanism.segment_count)
        return replace(
            mechanism,
            mass_kg=mechanism.mass_kg * (1.0 + affected * values["mass_share"]),
            centre_of_mass_m=mechanism.centre_of_mass_m + affected * values["centre_m"],
            segment_length_m=mechanism.segment_length_m + affected * values["length_m"],
            contact_m=mechanism.contact_m + affected * values["contact_m"],
        )


class BaseTolerance(Effect):
    """A base that was levelled to within a tolerance: gravity turns in its frame."""

    name = "base_tolerance"
    acts_on = "arm"
    about = "the tolerance of a levelled base"
    source = "Siciliano et al., Robotics: Modelling, Planning and Control, 2009, section 7.3"
    order = _LAST
    parameters = (
        Parameter("about_y_rad", "rad", -0.3, 0.3, _TILT_RAD, "of gravity about the base's y"),
        Parameter("about_x_rad", "rad", -0.3, 0.3, _TILT_RAD, "of gravity about the base's x"),
    )
    tolerance = True

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        turn = np.array([values["about_x_rad"], values["about_y_rad"], 0.0])
        gravity = mechanism.gravity_m_s2
        return replace(mechanism, gravity_m_s2=gravity + np.cross(turn, gravity))


class JointTolerance(Effect):
    """Zeros of one joint: the actuators hold the lengths of other angles than the commanded."""

    name = "joint_tolerance"
    acts_on = "actuator"
    about = "the tolerance of a joint's zero"
    source = "Mooring, Roth, Driels: Fundamentals of Manipulator Calibration, 1991: joint offsets"
    sites = ("joint",)
    order = _LAST
    parameters = (
        Parameter("pitch_rad", "rad", -0.2, 0.2, _ZERO_RAD, "of the held pitch, in excess"),
        Parameter("yaw_rad", "rad", -0.2, 0.2, _ZERO_RAD, "of the held yaw, in excess"),
    )
    tolerance = True

    def joint_zeros_rad(self, place: str, values: Values, joint_count: int) -> Array:
        zeros_rad = np.zeros((len(values["pitch_rad"]), joint_count, 2))
        zeros_rad[:, int(place.rsplit("_", 1)[1]) - 1] = np.stack(
            [values["pitch_rad"], values["yaw_rad"]], axis=-1
        )
        return zeros_rad.reshape(len(zeros_rad), 2 * joint_count)
