"""Friction as drives have it: dry, viscous, by the load, and of tendons over their guides.

Each has a plain form, with which the search works, and richer ones (`richer`), which are tried
afterwards and kept where held-out trials ask for them (`friction_forms`).
"""

from __future__ import annotations

import mujoco
import numpy as np

from cablesense_gap.robot.effects import (
    LOPSIDED,
    PRESLIDING,
    SIDE,
    STRIBECK,
    STRIBECK_SPEED,
    Parameter,
    RobotEffect,
    Values,
    joint_unit,
    size,
)
from cablesense_gap.robot.model import Change, Robot
from cablesense_gap.robot.motion import Scale, rms

_LEAST_SPEED = 0.005
_MOST_SPEED = 5.0
"""Speeds until which friction may fall, by a joint's usual speed."""
_PRESLIDING = "elastic displacement before it slips the other way"


class DryFriction(RobotEffect):
    """A torque of constant size against the motion (Coulomb), with Dahl's transition.

    With Stribeck's share it is LuGre's law: bristles bend as far as friction at the present speed
    bends them. Their own damping acts within milliseconds, and is left out.
    """

    name = "joint_friction"
    about = "dry friction"
    source = "Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14(12), 1976"
    advice = "Turn the joint by hand without current: bearings, seals, brakes that drag, gears."
    against_motion = True
    numbers = (
        size("torque_n_m", "{torque}", 3.0, 0.05, "against the motion, whatever the load", 0.0),
    )

    def usual(self, robot: Robot, scale: Scale) -> float:
        return scale.typical_torque

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return *super().parameters(robot, scale), _presliding(robot, scale)

    def richer(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return _stribeck(robot, scale)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.friction[at] += values["torque_n_m"]
        change.presliding[at] = values[PRESLIDING]
        change.stribeck[at] = values[STRIBECK]
        change.stribeck_speed[at] = values[STRIBECK_SPEED]


class LoadFriction(RobotEffect):
    """A drive gives e^share times the torque that the joint transmits, e^-share when it brakes.

    Cables over guides do the same by Euler's law; share is then friction times wrap angle. Gear
    losses are stated either as a part of the drive's torque, 1 / (1 ± tanh share) of it, or of
    the joint's, 1 ± tanh share. Both are e^±share times cosh share, to the power of 1 and of -1.
    """

    name = "load_friction"
    about = "friction that grows with the load"
    advice = "Check gears, screws, and cables over guides: losses grow with the torque they pass."
    in_model = False
    against_motion = True

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        loss = size("share", "1", 0.9, 0.05, "logarithm of the loss", 0.0)
        about = "by the drive's torque at 1, by the joint's at -1, by Euler's law at 0"
        side = Parameter(SIDE, "1", -1.0, 1.0, 0.5, about, role="shape")
        return loss, _presliding(robot, scale), side

    def richer(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return _stribeck(robot, scale)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.load_friction[at] += values["share"]
        change.load_presliding[at] = values[PRESLIDING]
        change.load_side[at] = values[SIDE]
        change.load_stribeck[at] = values[STRIBECK]
        change.load_stribeck_speed[at] = values[STRIBECK_SPEED]


class TendonFriction(RobotEffect):
    """Tensions on the two sides of a guide differ by at most exp(μ θ).

    θ is the wrap angle at each site or geom on the tendon's path in the model. The loss acts on
    every joint that the tendon crosses beyond the guide, and grows with the tendon's tension,
    including its pretension.
    """

    name = "capstan_friction"
    at = "tendons"
    about = "friction of a tendon over its guides"
    source = "Euler's and Eytelwein's law at each guide; see cablesense_sim.cable_chain"
    advice = "Look for worn, dry or kinked guides and sheaths of this tendon."
    in_model = False
    against_motion = True
    presliding_forward = True

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
    adds = "damping"
    advice = "Check the lubricant and its temperature."
    numbers = (size("torque_s_n_m", "{torque} s/{position}", 60.0, 1.0, "by the speed", 0.0),)

    def usual(self, robot: Robot, scale: Scale) -> float:
        return 0.05 * scale.per(scale.speed)

    def richer(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (size(LOPSIDED, "1", 0.9, 0.2, "more of it forwards than on average, as a share"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.damping[at] += values["torque_s_n_m"]
        change.lopsided[at] = values[LOPSIDED]


def _presliding(robot: Robot, scale: Scale) -> Parameter:
    return _elastic(joint_unit(robot, "{position}"), rms(1e-3 * scale.position), _PRESLIDING)


def _stribeck(robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
    """By how much more friction is at rest, and the speed at which 1/e of that is left."""
    usual = rms(scale.speed)
    speed = Parameter(
        STRIBECK_SPEED,
        joint_unit(robot, "{position}/s"),
        _LEAST_SPEED * usual,
        _MOST_SPEED * usual,
        0.1 * usual,
        "speed at which a third of the additional friction is left",
        0.1 * usual,
        role="shape",
    )
    return size(STRIBECK, "1", 5.0, 0.3, "more friction at rest than in motion", 0.0), speed


def _elastic(unit: str, typical: float, about: str) -> Parameter:
    low = 0.02 * typical
    high = 50.0 * typical
    return Parameter(PRESLIDING, unit, low, high, typical, about, typical, role="shape")
