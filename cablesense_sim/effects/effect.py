"""What every effect declares, and the ways in which it can act on an arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_sim.effects.transmission import Transmission
from cablesense_sim.mechanism import Mechanism

Values = Mapping[str, Array]
"""Parameter values by name, each (P,): one for every arm that is simulated side by side."""

WHOLE_ARM = "arm"
"""The place of an effect that is everywhere."""


@dataclass(frozen=True)
class Parameter:
    """One number that an effect has.

    Attributes:
        name: with its unit at the end, as in `torque_n_m`.
        unit: for people.
        low, high: the plausible range; an arm file outside it is refused.
        typical: what one expects to meet; for a tolerance, one standard deviation.
        default: what holds where nothing is said.
        role: a `size` of zero means that the effect is absent, and its default is zero; a `shape`
            determines how the effect behaves where it is present.
        starts: values of a shape to screen with.
        trials: values of a shape from which a fit should begin.
        about: what it means, in a few words.
    """

    name: str
    unit: str
    low: float
    high: float
    typical: float
    about: str
    default: float = 0.0
    role: Literal["size", "shape"] = "size"
    starts: tuple[float, ...] = ()
    trials: tuple[float, ...] = ()


class Effect:
    """Base of all effects; the defaults do nothing.

    Attributes:
        name: as arm files and verdicts call it.
        acts_on: where in the chain from arm to reading it acts.
        about: what it is, as the end of `the gap comes from …`.
        source: where the model comes from.
        parameters: sizes first.
        advice: what someone at the arm can check or do about it, in sentences; may be empty.
        order: of those that act on the same, lower ones act first, and equal ones by name. The
            default follows all that change a tension or signal and only add to it.
        needs_time: whether it acts by the time that passes, and not only by the samples' order.
        tolerance: whether it is manufacturing tolerance, fitted beside all others and no cause.
    """

    name: ClassVar[str]
    acts_on: ClassVar[Literal["arm", "transmission", "actuator", "sensor"]]
    about: ClassVar[str]
    source: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    advice: ClassVar[str] = ""
    order: ClassVar[int] = 0
    needs_time: ClassVar[bool] = False
    tolerance: ClassVar[bool] = False

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        """Where it can sit: `arm`, `segment_n`, `joint_n`, `cable_i` or what the effect names."""
        return (WHOLE_ARM,)

    def history(self, segment_count: int, cable_count: int) -> tuple[Parameter, ...]:
        """Further shapes, zero if not given: what the past left in each cable or joint."""
        return ()

    def amend(self, mechanism: Mechanism, place: str, values: Mapping[str, float]) -> Mechanism:
        """The mechanism as the effect leaves it."""
        return mechanism

    def actuation(self, place: str, values: Values) -> Actuation | None:
        """What it does between the commanded and the held cable length."""
        return None

    def transmission(self, place: str, values: Values) -> Transmission | None:
        """What it does along the cables and in the joints, where that depends on the past."""
        return None

    def sensing(self, place: str, values: Values) -> Sensing | None:
        """What it does between the tension at the actuator and the reading."""
        return None


def segments(segment_count: int) -> tuple[str, ...]:
    """`segment_1` and so on."""
    return tuple(f"segment_{n + 1}" for n in range(segment_count))


def joints(segment_count: int) -> tuple[str, ...]:
    """`joint_1` and so on: universal joints, both axes."""
    return tuple(f"joint_{n + 1}" for n in range(segment_count))


def cables(cable_count: int) -> tuple[str, ...]:
    """`cable_1` and so on."""
    return tuple(f"cable_{i + 1}" for i in range(cable_count))


def chosen(place: str, count: int) -> NDArray[np.bool_]:
    """(count,) which of the segments, joints or cables a place means; `arm` means all."""
    if place == WHOLE_ARM:
        return np.ones(count, dtype=bool)
    return np.arange(1, count + 1) == int(place.rsplit("_", 1)[1])


def own_cables(place: str, mechanism: Mechanism) -> NDArray[np.bool_]:
    """(M,) which cables end on the segment that a place means; `arm` means all."""
    if place == WHOLE_ARM:
        return np.ones(mechanism.cable_count, dtype=bool)
    return mechanism.cable_segment == int(place.rsplit("_", 1)[1])


class Actuation:
    """Base: passes the command on. Holds its own state, for P arms side by side."""

    def step(self, time_s: float, held_m: Array) -> Array:
        """Lengths (P, M) really held, given those commanded, at the next moment."""
        return held_m


class Sensing:
    """Base: a perfect sensor. Holds its own state, for P arms side by side."""

    def step(self, time_s: float, tensions_n: Array) -> Array:
        """Readings (P, M) of tensions (P, M) at the next moment."""
        return tensions_n
