"""The base of all effects of a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from cablesense_base import Array
from cablesense_gap.robot.model import Change, Robot
from cablesense_sim.effects.effect import WHOLE_ARM as WHOLE_ARM
from cablesense_sim.effects.effect import EffectDescription
from cablesense_sim.effects.effect import Parameter as Parameter

Values = Mapping[str, float]
PRESLIDING, SIDE = "presliding", "side"
"""Parameters of friction that MJCF cannot express; the first has the unit of its place."""


@dataclass(frozen=True)
class Scale:
    """How large torques and motion are in one recording; typical sizes follow from it.

    Attributes:
        torque: (J,) root mean square of the torque at each joint.
        speed: (J,) root mean square of its speed while it moves.
        acceleration: (J,) root mean square of its acceleration while it moves.
        position: (J,) half its span.
        inertia: (J,) that it feels alone, by the nominal model.
    """

    torque: Array
    speed: Array
    acceleration: Array
    position: Array
    inertia: Array

    def per(self, other: Array) -> float:
        """The typical ratio of a joint's torque to another quantity (J,) of that joint."""
        return rms(self.torque / np.maximum(other, 1e-2 * rms(other) + 1e-9))

    @property
    def typical_torque(self) -> float:
        """Root mean square over all joints."""
        return rms(self.torque)


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


class RobotEffect(EffectDescription):
    """Base of all effects of a robot.

    Attributes:
        at: the kind of places where it can be, `arm` for the whole robot.
        numbers: those that are the same on every robot and recording; `parameters` has others.
            Units are as of `joint_unit`.
        adds: the array of `Change` to which its one number is added, unless `act` does otherwise.
        in_model: whether MJCF has a place for it.
        presliding_forward: whether the forward comparison uses its presliding displacement too.
        of_torques: whether it is in readings of torques alone.
        of_zeros: whether it cannot be identified if each trial has its own encoder zeros.
    """

    source: ClassVar[str] = "Siciliano et al., Robotics: Modelling, Planning and Control, 2009"
    at: ClassVar[Literal["joints", "bodies", "tendons", "arm"]] = "joints"
    numbers: ClassVar[tuple[Parameter, ...]] = ()
    adds: ClassVar[str] = ""
    in_model: ClassVar[bool] = True
    presliding_forward: ClassVar[bool] = False
    of_torques: ClassVar[bool] = False
    of_zeros: ClassVar[bool] = False

    def places(self, robot: Robot) -> tuple[str, ...]:
        """Where it can be."""
        names: dict[str, tuple[str, ...]] = {
            "joints": robot.joints, "bodies": robot.bodies, "tendons": robot.tendons,
        }  # fmt: skip
        return names.get(self.at, (WHOLE_ARM,))

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        """Its numbers, with ranges and typical sizes on this robot and recording."""
        return tuple(replace(p, unit=joint_unit(robot, p.unit)) for p in self.numbers)

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
