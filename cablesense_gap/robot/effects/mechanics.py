"""Effects of the machine itself: play, coupling and springs, masses and inertias."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from cablesense_gap.robot.effects import Parameter, RobotEffect, Values, size
from cablesense_gap.robot.model import Change, Robot
from cablesense_gap.robot.motion import Scale, rms


class Play(RobotEffect):
    """Play between drive and joint: the joint is driven at either end of it, and free between.

    Positions are taken to be the drive's. The joint's place in the play follows from the torque
    that its link needs.
    """

    name = "backlash"
    about = "backlash"
    adds = "play"
    source = "Nordin and Gutman, Controlling mechanical systems with backlash, Automatica 38, 2002"
    advice = "Hold the drive and move the joint by hand: gears, couplings, belts that are slack."
    in_model = False
    numbers = (
        size("play_rad", "{position}", 0.3, 0.01, "from one end of the play to the other", 0.0),
    )


class JointCoupling(RobotEffect):
    """One drive moves the next joint too, for example where a cable passes a joint on its way."""

    name = "joint_coupling"
    about = "a joint that moves with its neighbour's drive"
    advice = "Hold all drives but one, turn that, and look whether another joint moves."
    in_model = False
    numbers = (size("share", "1", 1.2, 0.05, "of the drive's motion"),)

    def places(self, robot: Robot) -> tuple[str, ...]:
        """`a_into_b` for neighbours: the drive of a moves joint b."""
        return tuple(
            f"{drive}_into_{joint}"
            for pair in pairwise(robot.joints)
            for drive, joint in (pair, pair[::-1])
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        i, back = divmod(at, 2)
        drive, joint = (i + 1, i) if back else (i, i + 1)
        change.coupling[joint, drive] += values["share"]


class JointSpring(RobotEffect):
    """A torque in proportion to the joint's position, for example of hoses and wires."""

    name = "joint_spring"
    about = "a spring in the joint"
    adds = "stiffness"
    advice = "Look at hoses, wires and covers that bend with the joint."
    numbers = (
        size(
            "stiffness_n_m_rad",
            "{torque}/{position}",
            60.0,
            1.0,
            "towards the model's reference",
            0.0,
        ),
    )

    def usual(self, robot: Robot, scale: Scale) -> float:
        return 0.05 * scale.per(scale.position)


class ServoGain(RobotEffect):
    """A position servo that holds its command more or less stiffly; its damping stays."""

    name = "servo_gain"
    about = "a position servo with another gain"
    adds = "servo_gain"
    source = "MuJoCo, XML reference: actuator/position, kp"
    advice = (
        "Read the servo's gain, or hang a known weight on the joint and see how far it yields."
    )
    of_servos = True
    numbers = (size("share", "1", 9.0, 0.2, "stiffer than modelled", -0.9, spread=5.0),)

    def places(self, robot: Robot) -> tuple[str, ...]:
        """Every joint, if all have a servo."""
        return robot.joints if (robot.servos >= 0).all() else ()


class LinkMass(RobotEffect):
    """Mass and inertia of a link that are off by the same share."""

    name = "link_mass"
    at = "bodies"
    about = "a wrong link mass"
    advice = "Weigh the link, or compare its mass with the drawing's."
    numbers = (size("share", "1", 3.0, 0.1, "heavier than modelled", -0.9, spread=5.0),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.mass_kg[at] *= 1.0 + values["share"]
        change.inertia_kg_m2[at] *= 1.0 + values["share"]


class LinkCentre(RobotEffect):
    """A centre of mass that is shifted along the link's axes."""

    name = "link_centre"
    at = "bodies"
    about = "a wrong centre of mass"
    advice = "Balance the link on an edge, or compare with the drawing."
    numbers = tuple(size(f"{axis}_m", "m", 1.0, 0.1, f"along the link's {axis}") for axis in "xyz")

    def usual(self, robot: Robot, scale: Scale) -> float:
        return robot.longest_link_m

    def act(self, change: Change, at: int, values: Values) -> None:
        change.centre_m[at] += [values[f"{axis}_m"] for axis in "xyz"]


class AddedMass(RobotEffect):
    """A point mass fixed to a body: a tool, a camera, a cable chain.

    Beside one that the robot lists, a negative one is what was taken off it.
    """

    name = "payload"
    at = "bodies"
    adds_up = True
    about = "mass that nobody modelled"
    source = "Featherstone, Rigid Body Dynamics Algorithms, 2008, section 2.13"
    advice = "Weigh the additions there: tools, cameras, covers, cables."

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        """The torques of the recording limit the mass, as a tool may be far from a link's mass.

        The typical mass loads a joint by a tenth of its torque. The largest takes all of it, by
        acceleration alone.
        """
        body_mass = robot.model.body_mass[robot.body_ids]
        hinge = np.array(robot.position_units) == "rad"
        lever_m = np.where(hinge, robot.longest_link_m, 1.0)
        weight = lever_m * float(np.linalg.norm(robot.model.opt.gravity))
        by_motion = lever_m**2 * scale.acceleration
        least = 0.1 * float((scale.torque / np.maximum(weight + by_motion, 1e-9)).min())
        most = float((scale.torque / np.maximum(by_motion, 0.01 * weight + 1e-9)).max())
        typical = max(least, 0.02 * float(body_mass.min()))
        most = max(most, 10.0 * float(body_mass.max()))
        moment = 0.3 * typical * robot.longest_link_m
        spread = most / typical
        about = "first moment about the body's centre of mass: over the mass it gives the place"
        mass = size("mass_kg", "kg", 10.0 * most, typical, "of what was added", 0.0, spread)
        far = 20.0 * spread * moment
        names = [f"moment_{axis}_kg_m" for axis in "xyz"]
        return mass, *(size(n, "kg·m", far, moment, about, spread=spread) for n in names)

    def act(self, change: Change, at: int, values: Values) -> None:
        moment = np.array([values[f"moment_{axis}_kg_m"] for axis in "xyz"])
        mass = max(values["mass_kg"], float(np.linalg.norm(moment)) / change.farthest_mass_m)
        if mass > 0.0:
            change.add_point_mass(at, mass, change.centre_m[at] + moment / mass)


class RotorInertia(RobotEffect):
    """Inertia that resists only the joint's own acceleration."""

    name = "rotor_inertia"
    about = "inertia of a rotor that nobody modelled"
    adds = "armature"
    advice = "Take the rotor's inertia from its data sheet, times the gear ratio squared."
    numbers = (size("inertia_kg_m2", "{inertia}", 60.0, 1.0, "as the joint feels it", 0.0),)

    def usual(self, robot: Robot, scale: Scale) -> float:
        """Slow motion shows no inertia, so the model's own inertia limits the typical size."""
        return min(0.05 * scale.per(scale.acceleration), 0.3 * rms(scale.inertia))


class TiltedBase(RobotEffect):
    """The base is turned about its axes, so that gravity has another direction in its frame."""

    name = "base_tilt"
    at = "arm"
    about = "a base that is not level"
    advice = "Put a level on the base."

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
