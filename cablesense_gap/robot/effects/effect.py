"""What an effect of a robot is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cablesense_base import Array
from cablesense_gap.robot.model import Change, Robot
from cablesense_sim.effects.effect import WHOLE_ARM as WHOLE_ARM
from cablesense_sim.effects.effect import Parameter as Parameter

Values = Mapping[str, float]
PRESLIDING, SIDE = "presliding_rad", "side"
"""No MJCF has a word for these."""


@dataclass(frozen=True)
class Scale:
    """How large things are in one recording, so that sizes have typical values.

    Attributes:
        torque: (J,) root mean square of the torque at each joint.
        speed: (J,) that of its speed while it moves.
        acceleration: (J,) that of its acceleration while it moves.
        position: (J,) half its span.
    """

    torque: Array
    speed: Array
    acceleration: Array
    position: Array

    def per(self, what: Array) -> float:
        """A torque's typical ratio to something else that each joint has."""
        return float(rms(self.torque / np.maximum(what, 1e-2 * rms(what) + 1e-9)))

    @property
    def typical_torque(self) -> float:
        """Over all joints."""
        return rms(self.torque)


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def presliding(robot: Robot, scale: Scale) -> Parameter:
    """How far a joint that turns round gives before its friction slips the other way."""
    typical = rms(1e-3 * scale.position)
    unit = joint_unit(robot, "{position}")
    about = "given before it slips the other way"
    return Parameter(
        PRESLIDING, unit, 0.02 * typical, 50.0 * typical, typical, about, typical, role="shape"
    )


class Effect(ABC):
    """Base of all effects of a robot.

    Attributes:
        name: as verdicts call it.
        about: what it is, as the end of `the gap comes from …`.
        source: where its law comes from.
        advice: what someone at the robot can check or do about it.
        tolerance: whether it is manufacturing tolerance, fitted beside all others and no cause.
        in_model: whether an MJCF has a place for it.
        against_motion: whether it turns round with the motion, whatever the speed.
        withheld: whether `gap withhold` hides it.
        gives_forward: whether it gives way before it slips when compared forward too.
        of_zeros: whether encoders that are zeroed where each trial begins leave none to find.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    source: ClassVar[str] = "Siciliano et al., Robotics: Modelling, Planning and Control, 2009"
    advice: ClassVar[str] = ""
    tolerance: ClassVar[bool] = False
    in_model: ClassVar[bool] = True
    against_motion: ClassVar[bool] = False
    withheld: ClassVar[bool] = True
    gives_forward: ClassVar[bool] = False
    of_zeros: ClassVar[bool] = False

    def places(self, robot: Robot) -> tuple[str, ...]:
        """Where it can sit: joints, bodies, or `arm` for the whole robot."""
        return robot.joints

    @abstractmethod
    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        """Its numbers, with ranges and typical sizes on this robot and recording."""

    @abstractmethod
    def act(self, change: Change, at: int, values: Values) -> None:
        """Change the robot; `at` is the number of the place among `places`."""


def joint_unit(robot: Robot, form: str) -> str:
    """A unit of the joints from those of their `{torque}`, `{position}` and `{inertia}`.

    A robot with hinges and slides has one of each, joined by `or`.
    """
    inertia = {"N·m": "kg·m²", "N": "kg"}
    kinds = zip(robot.torque_units, robot.position_units, strict=True)
    units = (form.format(torque=t, position=p, inertia=inertia[t]) for t, p in kinds)
    return " or ".join(dict.fromkeys(units))


def size(
    name: str, unit: str, most: float, typical: float, about: str, least: float | None = None
) -> Parameter:
    """A size from `least`, by default minus `most`, to `most`."""
    return Parameter(name, unit, -most if least is None else least, most, typical, about)
