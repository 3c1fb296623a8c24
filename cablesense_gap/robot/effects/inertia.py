"""Masses, inertias and gravity."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cablesense_gap.robot.effects.effect import (
    WHOLE_ARM,
    Parameter,
    RobotEffect,
    Scale,
    Values,
    joint_unit,
    rms,
    size,
)
from cablesense_gap.robot.model import Change, Robot


class LinkMass(RobotEffect):
    """Mass and inertia of a link that are off by the same share."""

    name = "link_mass"
    about = "a wrong link mass"
    advice = "Weigh the link, or compare its mass with the drawing's."

    def places(self, robot: Robot) -> tuple[str, ...]:
        return robot.bodies

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (size("share", "1", 3.0, 0.1, "heavier than modelled", -0.9),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.mass_kg[at] *= 1.0 + values["share"]
        change.inertia_kg_m2[at] *= 1.0 + values["share"]


class LinkCentre(RobotEffect):
    """A centre of mass that is shifted along the link's axes."""

    name = "link_centre"
    about = "a wrong centre of mass"
    advice = "Balance the link on an edge, or compare with the drawing."

    def places(self, robot: Robot) -> tuple[str, ...]:
        return robot.bodies

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        reach = robot.reach_m
        return tuple(
            size(f"{axis}_m", "m", reach, 0.1 * reach, f"along the link's {axis}")
            for axis in "xyz"
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        change.centre_m[at] += [values[f"{axis}_m"] for axis in "xyz"]


class AddedMass(RobotEffect):
    """A point mass fixed to a body: a tool, a camera, a cable chain."""

    name = "payload"
    about = "mass that nobody modelled"
    source = "Featherstone, Rigid Body Dynamics Algorithms, 2008, section 2.13"
    advice = "Weigh what was added there: tools, cameras, covers, cables."

    def places(self, robot: Robot) -> tuple[str, ...]:
        return robot.bodies

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        typical = 0.1 * rms(robot.model.body_mass[robot.body_ids])
        moment = 0.3 * typical * robot.reach_m
        about = "first moment about the body's centre of mass: over the mass it gives the place"
        return (
            size("mass_kg", "kg", 100.0 * typical, typical, "of what was added", 0.0),
            *(
                size(f"moment_{axis}_kg_m", "kg·m", 200.0 * moment, moment, about)
                for axis in "xyz"
            ),
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        moment = np.array([values[f"moment_{axis}_kg_m"] for axis in "xyz"])
        mass = max(values["mass_kg"], float(np.linalg.norm(moment)) / change.reach_m)
        if mass > 0.0:
            change.add_point_mass(at, mass, change.centre_m[at] + moment / mass)


class RotorInertia(RobotEffect):
    """Inertia that resists only the joint's own acceleration."""

    name = "rotor_inertia"
    about = "inertia of a rotor that nobody modelled"
    advice = "Take the rotor's inertia from its data sheet, times the gear ratio squared."

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        typical = 0.05 * scale.per(scale.acceleration)
        unit, about = joint_unit(robot, "{inertia}"), "as the joint feels it"
        return (size("inertia_kg_m2", unit, 60.0 * typical, typical, about, 0.0),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.armature[at] += values["inertia_kg_m2"]


class TiltedBase(RobotEffect):
    """The base is turned about its axes, so that gravity has another direction in its frame."""

    name = "base_tilt"
    about = "a base that is not level"
    advice = "Put a level on the base."

    def places(self, robot: Robot) -> tuple[str, ...]:
        return (WHOLE_ARM,)

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        """A rotation about gravity's own axis changes nothing and is left out."""
        along = np.abs(robot.model.opt.gravity)
        return tuple(
            size(f"about_{axis}_rad", "rad", 0.6, 0.03, f"the base turned about its {axis}")
            for axis, share in zip("xyz", along / max(along.max(), 1e-9), strict=True)
            if share < 1.0
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        turned = Rotation.from_rotvec([values[f"about_{axis}_rad"] for axis in "xyz"])
        change.gravity_m_s2 = turned.inv().apply(change.gravity_m_s2)
