"""Friction in joints, in drives and of tendons over guides."""

from __future__ import annotations

import mujoco
import numpy as np

from cablesense_gap.robot.effects.effect import (
    PRESLIDING,
    SIDE,
    Parameter,
    RobotEffect,
    Scale,
    Values,
    joint_unit,
    rms,
    size,
)
from cablesense_gap.robot.model import Change, Robot

_PRESLIDING = "elastic displacement before it slips the other way"


class DryFriction(RobotEffect):
    """A torque of constant size against the motion (Coulomb), with Dahl's transition."""

    name = "joint_friction"
    about = "dry friction"
    source = "Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14(12), 1976"
    advice = "Turn the joint by hand without current: bearings, seals, brakes that drag, gears."
    against_motion = True

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        most, typical = 3.0 * scale.typical_torque, 0.05 * scale.typical_torque
        unit, about = joint_unit(robot, "{torque}"), "against the motion, whatever the load"
        torque = size("torque_n_m", unit, most, typical, about, 0.0)
        return torque, _presliding(robot, scale)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.friction[at] += values["torque_n_m"]
        change.presliding[at] = values[PRESLIDING]


class LoadFriction(RobotEffect):
    """A drive gives e^share times the torque that the joint transmits, e^-share when it brakes.

    Cables over guides do the same by Euler's law; share is then friction times wrap angle. Gear
    losses are stated either as a part of the drive's torque, 1 / (1 ± tanh share) of it, or of
    the joint's, 1 ± tanh share. Both are e^±share times cosh share, to the power of 1 and of -1.
    """

    name = "load_friction"
    about = "friction that grows with the load"
    advice = (
        "Check gears, screws, and cables over guides: their losses grow with what they transmit."
    )
    in_model = False
    against_motion = True

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        loss = size("share", "1", 0.9, 0.05, "logarithm of the loss", 0.0)
        about = "by the drive's torque at 1, by the joint's at -1, by Euler's law at 0"
        side = Parameter(SIDE, "1", -1.0, 1.0, 0.5, about, role="shape")
        return loss, _presliding(robot, scale), side

    def act(self, change: Change, at: int, values: Values) -> None:
        change.load_friction[at] += values["share"]
        change.load_presliding[at], change.load_side[at] = values[PRESLIDING], values[SIDE]


class TendonFriction(RobotEffect):
    """Tensions on the two sides of a guide differ by at most exp(μ θ).

    θ is the wrap angle at each site or geom on the tendon's path in the model. The loss acts on
    every joint that the tendon crosses beyond the guide, and grows with the tendon's tension,
    including its pretension.
    """

    name = "capstan_friction"
    about = "friction of a tendon over its guides"
    source = "Euler's and Eytelwein's law at each guide; see cablesense_sim.cable_chain"
    advice = "Look for worn, dry or kinked guides and sheaths of this tendon."
    in_model = False
    against_motion = True
    presliding_forward = True
    withheld = False

    def places(self, robot: Robot) -> tuple[str, ...]:
        return robot.tendons

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        data = mujoco.MjData(robot.model)
        mujoco.mj_fwdPosition(robot.model, data)
        typical = 1e-2 * rms(scale.position) * float(np.abs(data.ten_J).max(initial=1e-6))
        return (
            size("coefficient", "1", 1.5, 0.1, "of friction between tendon and guides", 0.0),
            _elastic("m", typical, f"{_PRESLIDING}, of cable"),
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        change.capstan_friction[at] += values["coefficient"]
        change.capstan_presliding[at] = values[PRESLIDING]


class ViscousFriction(RobotEffect):
    """A torque against the motion in proportion to the speed."""

    name = "viscous_friction"
    about = "viscous friction"
    advice = "Check the lubricant and its temperature."

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        typical = 0.05 * scale.per(scale.speed)
        unit = joint_unit(robot, "{torque} s/{position}")
        return (size("torque_s_n_m", unit, 60.0 * typical, typical, "by the speed", 0.0),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.damping[at] += values["torque_s_n_m"]


def _presliding(robot: Robot, scale: Scale) -> Parameter:
    return _elastic(joint_unit(robot, "{position}"), rms(1e-3 * scale.position), _PRESLIDING)


def _elastic(unit: str, typical: float, about: str) -> Parameter:
    low, high = 0.02 * typical, 50.0 * typical
    return Parameter(PRESLIDING, unit, low, high, typical, about, typical, role="shape")
