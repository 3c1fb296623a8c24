"""The base of all effects, and the ways in which an effect can act on an arm."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.cable_pull import CablePull

if TYPE_CHECKING:
    from cablesense_sim.mechanism import Mechanism

OneArm = Mapping[str, float]
"""Parameter values by name, of one arm."""

Values = Mapping[str, Array]
"""The same, each (P,): one for every arm that is simulated side by side."""

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
        default: its value where none is given.
        role: a `size` of zero means that the effect is absent, and its default is zero; a `shape`
            determines how the effect behaves when it is present.
        starts: values to screen with, instead of the default of a shape or the typical size.
        trials: values of a shape from which a fit should begin.
        about: what it means, in a few words.
        fades: whether its influence fades along a recording, as a friction state does.
        past: whether it describes the state before the first sample, which differs between
            recordings.
        relative: whether it is the share by which a positive quantity is larger, so that a
            quarter and four times the quantity are equally far from zero.
        spread: a size is expected within this many typical ones of zero (one standard deviation).
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
    fades: bool = False
    past: bool = False
    relative: bool = False
    spread: float = 3.0


shape = partial(Parameter, role="shape")
"""A parameter of the role `shape`."""


class EffectDescription:
    """Fields that effects of this arm and effects of any robot have in common.

    Attributes:
        name: as arm files and verdicts call it.
        about: what it is, as the end of `the gap comes from …`.
        source: where its law comes from.
        advice: what someone at the machine can check or do about it, in sentences; may be empty.
        tolerance: whether it is a manufacturing tolerance, fitted together with all others and
            never named as a cause.
        against_motion: whether it reverses with the motion, whatever the speed.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    source: ClassVar[str]
    advice: ClassVar[str] = ""
    tolerance: ClassVar[bool] = False
    against_motion: ClassVar[bool] = False


class Effect(EffectDescription):
    """Base of all effects of the arm; the defaults do nothing.

    None sees a recorded column of one's own: one on the arm's body (`amend`) makes one mechanism
    for all rows, one on actuators or sensors gets times and values. docs/extending.md ("An effect
    that reads a column") says what such an effect needs first.

    Attributes: see `EffectDescription`, and
        acts_on: where in the chain from load to reading it acts.
        sites: the kinds of places where it can be: `arm`, `segment`, `joint`, `cable`.
        parameters: sizes first.
        order: among effects that act on the same, lower ones act first, equal ones by name. Those
            that scale or filter a signal come before those that add to it, which have the default.
        needs_time: whether it depends on the time that passes, and not only on the samples' order.
        version: of its law; a model that was trained on another version is refused.
        product: of an effect with one size and one shape, the size times `lever`; readings may
            show it and neither factor.
    """

    acts_on: ClassVar[Literal["load", "arm", "transmission", "actuator", "sensor"]]
    parameters: ClassVar[tuple[Parameter, ...]]
    sites: ClassVar[tuple[str, ...]] = (WHOLE_ARM,)
    order: ClassVar[int] = 0
    needs_time: ClassVar[bool] = False
    version: ClassVar[int] = 1
    product: ClassVar[Parameter | None] = None

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        """Where it can be: `arm`, `segment_n`, `joint_n`, `cable_i` or what the effect names."""
        counts = {"segment": segment_count, "joint": segment_count, "cable": cable_count}
        places = (_numbered(s, counts[s]) if s in counts else (s,) for s in self.sites)
        return tuple(itertools.chain.from_iterable(places))

    def history(self, segment_count: int, cable_count: int) -> tuple[Parameter, ...]:
        """Further shapes, zero if not given: the friction state of each cable or joint."""
        return ()

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        """The mechanism as the effect leaves it."""
        return mechanism

    def amend_all(
        self, mechanism: Mechanism, everywhere: Sequence[tuple[str, OneArm]]
    ) -> Mechanism:
        """The mechanism as the effect leaves it in several places, one after the other."""
        for place, values in everywhere:
            mechanism = self.amend(mechanism, place, values)
        return mechanism

    def lever(self, mechanism: Mechanism, place: str, values: OneArm) -> float:
        """The factor of the size in `product`, linear in the shape."""
        return 1.0

    def loading(self, place: str, values: Values) -> Array | None:
        """(P, 3, 3) from a load as it is recorded to the one that acts, both in base axes."""
        return None

    def joint_zeros_rad(self, place: str, values: Values, joint_count: int) -> Array | None:
        """(P, 2 joint_count) by which angles whose lengths are held exceed the commanded ones."""
        return None

    def actuation(self, place: str, values: Values) -> Actuation | None:
        """Its action between the commanded and the held cable length."""
        return None

    def transmission(self, place: str, values: Values) -> Transmission | None:
        """Its action along the cables and in the joints, if that depends on the history."""
        return None

    def sensing(self, place: str, values: Values) -> Sensing | None:
        """Its action between the tension at the actuator and the reading."""
        return None


def cables(cable_count: int) -> tuple[str, ...]:
    """`cable_1` and so on."""
    return _numbered("cable", cable_count)


def _numbered(kind: str, count: int) -> tuple[str, ...]:
    return tuple(f"{kind}_{i + 1}" for i in range(count))


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


class _Signal:
    """Something that passes values on; holds its own state, for P arms side by side."""

    def step(self, time_s: float, values: Array) -> Array:
        """Values (P, M) behind it, given those before it, at the next moment."""
        return values

    def along(self, time_s: Array, values: Array) -> Array:
        """Values (P, R, M) behind the effect, of values at R moments (R,) one after another."""
        rows = [self.step(t, values[:, row]) for row, t in enumerate(time_s)]
        return np.stack(rows, axis=1)


class Actuation(_Signal):
    """Base: from the commanded cable lengths to those really held; passes them on."""


class Sensing(_Signal):
    """Base: from tensions to readings; a perfect sensor."""


class Instant(Sensing):
    """A sensor without a state: a function of the time, s, and the tensions.

    It takes one moment and (P, M), or (R,) moments and (R, P, M).
    """

    def __init__(self, reading_n: Callable[[float | Array, Array], Array]) -> None:
        self._reading_n = reading_n

    def step(self, time_s: float, values: Array) -> Array:
        return self._reading_n(time_s, values)

    def along(self, time_s: Array, values: Array) -> Array:
        return np.moveaxis(self._reading_n(time_s, np.moveaxis(values, 1, 0)), 0, 1)


def shifted(place: str, offset_n: Array) -> Sensing:
    """A sensor that adds offsets (P,) to the readings of a place."""
    return Instant(lambda _, n: n + offset_n[:, None] * chosen(place, n.shape[-1]))


class ArmEquilibrium(NamedTuple):
    """Where P arms side by side rest at one moment.

    Attributes:
        time_s: the moment.
        angles_rad: (P, 2N) joint angles.
        spans_m: (P, M, N) cables' spans across the joints, zero where a cable does not pass.
        bends_rad: (P, M, N, 2) by how much a cable turns at the guides before and after a joint.
        tensions_n: (P, M) at the actuators.
    """

    time_s: float
    angles_rad: Array
    spans_m: Array
    bends_rad: Array
    tensions_n: Array


class Transmission:
    """Base: an ideal transmission. Holds the state of P quasi-static arms side by side.

    The search for the next equilibrium calls every method but `settle` at trial poses, as often
    as it needs. `settle` gives the equilibrium that was found; only it may change the state.
    """

    def begin(self, mechanism: Mechanism, equilibrium: ArmEquilibrium) -> None:
        """Set the state before the first sample; `equilibrium` is that without history."""

    def lengthening_m(self, time_s: float) -> Array | None:
        """(P, M) by which the cables are longer than when they were tensioned."""
        return None

    def hold(self, slack_m: Array, longer_m: Array) -> None:
        """Take the lengths that hold the cables, before a search; each (P, M).

        A cable is just slack where its spans add up to `slack_m`, which the actuators set, and
        to the length `longer_m` that it has gained since it was tensioned.
        """

    def pull(self, spans_m: Array, bends_rad: Array) -> CablePull | None:
        """Tensions (P, M, 1 + N) at the actuator and in each span, if not all alike."""
        return None

    def joint_torque_n_m(self, angles_rad: Array) -> tuple[Array, Array] | None:
        """Torques (P, 2N) that resist, and their derivative by each joint's own angle."""
        return None

    def settle(self, equilibrium: ArmEquilibrium) -> None:
        """Take the equilibrium that was reached."""
