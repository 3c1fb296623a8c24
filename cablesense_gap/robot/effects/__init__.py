"""Effects of a robot: their base; `amending.known_robot_effects` finds those of the modules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Literal

from cablesense_gap.robot.model import Change, Robot
from cablesense_gap.robot.motion import Scale
from cablesense_sim.effects.effect import WHOLE_ARM as WHOLE_ARM
from cablesense_sim.effects.effect import EffectDescription
from cablesense_sim.effects.effect import Parameter as Parameter

Values = Mapping[str, float]
PRESLIDING = "presliding"
SIDE = "side"
STRIBECK = "stribeck_share"
STRIBECK_SPEED = "stribeck_rad_s"
LOPSIDED = "lopsided"
OF_FORM = (PRESLIDING, SIDE, STRIBECK, STRIBECK_SPEED, LOPSIDED)
"""Parameters of friction that MJCF cannot express; the first has the unit of its place."""


class RobotEffect(EffectDescription):
    """Base of all effects of a robot.

    Attributes:
        at: the kind of places where it can be, `arm` for the whole robot.
        numbers: with units as of `joint_unit`, their ranges and typical sizes in those of
            `usual`; `parameters` has others.
        adds: the array of `Change` to which its one number is added, unless `act` does otherwise.
        in_model: whether MJCF has a place for it.
        presliding_forward: whether the forward comparison uses its presliding displacement too.
        of_torques: whether it is in readings of torques alone.
        of_zeros: whether it cannot be identified if each trial has its own encoder zeros.
        of_gains: whether it is at joints whose torque constant is known, as stated, and not at
            those whose torques are currents without one.
        of_currents: whether it is at the latter alone.
        of_servos: whether it shows only where motion is compared with the commands of servos.
        adds_up: whether its numbers at one place add up over lists of effects, as one cause.
    """

    source: ClassVar[str] = "Siciliano et al., Robotics: Modelling, Planning and Control, 2009"
    at: ClassVar[Literal["joints", "bodies", "tendons", "arm"]] = "joints"
    numbers: ClassVar[tuple[Parameter, ...]] = ()
    adds: ClassVar[str] = ""
    in_model: ClassVar[bool] = True
    presliding_forward: ClassVar[bool] = False
    of_torques: ClassVar[bool] = False
    of_zeros: ClassVar[bool] = False
    of_servos: ClassVar[bool] = False
    of_gains: ClassVar[bool] = False
    of_currents: ClassVar[bool] = False
    adds_up: ClassVar[bool] = False

    def places(self, robot: Robot) -> tuple[str, ...]:
        """Places of a robot that the effect can be in, by name."""
        names: dict[str, tuple[str, ...]] = {
            "joints": robot.joints,
            "bodies": robot.bodies,
            "tendons": robot.tendons,
        }
        return names.get(self.at, (WHOLE_ARM,))

    def usual(self, robot: Robot, scale: Scale) -> float:
        """What the ranges of `numbers` are multiplied by on this robot and recording."""
        return 1.0

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        """Its numbers, with ranges and typical sizes on this robot and recording."""
        usual = self.usual(robot, scale)
        return tuple(
            replace(
                p,
                unit=joint_unit(robot, p.unit),
                low=usual * p.low,
                high=usual * p.high,
                typical=usual * p.typical,
            )
            for p in self.numbers
        )

    def richer(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        """Numbers of its richer forms, which are tried once the plain one is found."""
        return ()

    def act(self, change: Change, at: int, values: Values) -> None:
        """Change the robot; `at` is the index of the place in `places`."""
        getattr(change, self.adds)[at] += sum(values.values())


def joint_unit(robot: Robot, form: str) -> str:
    """A unit built from the joints' `{torque}`, `{position}` and `{inertia}`.

    A robot with hinges and slides has one of each, joined by `or`.
    """
    inertia = {"N·m": "kg·m²", "N": "kg"}
    kinds = zip(robot.torque_units, robot.position_units, strict=True)
    units = (form.format(torque=t, position=p, inertia=inertia[t]) for t, p in kinds)
    return " or ".join(dict.fromkeys(units))


def size(
    name: str,
    unit: str,
    most: float,
    typical: float,
    about: str,
    least: float | None = None,
    spread: float = 3.0,
) -> Parameter:
    """A size from `least`, by default minus `most`, to `most`."""
    low = -most if least is None else least
    return Parameter(name, unit, low, most, typical, about, spread=spread)
