"""What every effect declares, how it can act on an arm, and dry friction as a state."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array

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
            determines how the effect behaves where it is present.
        starts: values to screen with, instead of the default of a shape or the typical size.
        trials: values of a shape from which a fit should begin.
        about: what it means, in a few words.
        fades: whether what it changes fades along a recording, as the past does.
        past: whether it is what the past has left, so that each recording has its own.
        relative: whether it is the share by which something positive is larger, so that a
            quarter and four times as much are equally far from nothing.
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


shape = partial(Parameter, role="shape")
"""A parameter that determines how the effect behaves where it is present."""

start_share = partial(shape, unit="1", low=-1.0, high=1.0, typical=0.5, fades=True, past=True)
"""A share of its limit that friction carries before the first sample."""

_SLIPS = "share of the contact that slips little by little"
ROUNDED = shape("rounded", "1", 0.0, 1.0, 0.5, _SLIPS, trials=(0.0, 1.0))
"""Of a `DryContact`."""


class Effect:
    """Base of all effects; the defaults do nothing.

    Attributes:
        name: as arm files and verdicts call it.
        acts_on: where in the chain from load to reading it acts.
        about: what it is, as the end of `the gap comes from …`.
        source: where the model comes from.
        sites: the kinds of its places: `arm`, `segment`, `joint`, `cable`.
        parameters: sizes first.
        advice: what someone at the arm can check or do about it, in sentences; may be empty.
        order: of those that act on the same, lower ones act first, and equal ones by name. The
            default follows all that change a tension or signal and only add to it.
        needs_time: whether it acts by the time that passes, and not only by the samples' order.
        tolerance: whether it is manufacturing tolerance, fitted beside all others and no cause.
        version: of its law; what was trained on another is refused.
    """

    name: ClassVar[str]
    acts_on: ClassVar[Literal["load", "arm", "transmission", "actuator", "sensor"]]
    about: ClassVar[str]
    source: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    sites: ClassVar[tuple[str, ...]] = (WHOLE_ARM,)
    advice: ClassVar[str] = ""
    order: ClassVar[int] = 0
    needs_time: ClassVar[bool] = False
    tolerance: ClassVar[bool] = False
    version: ClassVar[int] = 1

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        """Where it can sit: `arm`, `segment_n`, `joint_n`, `cable_i` or what the effect names."""
        counts = {"segment": segment_count, "joint": segment_count, "cable": cable_count}
        places = (_numbered(s, counts[s]) if s in counts else (s,) for s in self.sites)
        return tuple(itertools.chain.from_iterable(places))

    def history(self, segment_count: int, cable_count: int) -> tuple[Parameter, ...]:
        """Further shapes, zero if not given: what the past left in each cable or joint."""
        return ()

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        """The mechanism as the effect leaves it."""
        return mechanism

    def loading(self, place: str, values: Values) -> Array | None:
        """(P, 3, 3) from a load as it is recorded to the one that acts, both in base axes."""
        return None

    def actuation(self, place: str, values: Values) -> Actuation | None:
        """What it does between the commanded and the held cable length."""
        return None

    def transmission(self, place: str, values: Values) -> Transmission | None:
        """What it does along the cables and in the joints, where that depends on the past."""
        return None

    def sensing(self, place: str, values: Values) -> Sensing | None:
        """What it does between the tension at the actuator and the reading."""
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


class Actuation:
    """Base: passes the command on. Holds its own state, for P arms side by side."""

    def step(self, time_s: float, held_m: Array) -> Array:
        """Lengths (P, M) really held, given those commanded, at the next moment."""
        return held_m

    def along(self, time_s: Array, held_m: Array) -> Array:
        """The same (P, R, M) at R moments one after another."""
        return _one_by_one(self.step, time_s, held_m)


class Sensing:
    """Base: a perfect sensor. Holds its own state, for P arms side by side."""

    def step(self, time_s: float, tensions_n: Array) -> Array:
        """Readings (P, M) of tensions (P, M) at the next moment."""
        return tensions_n

    def along(self, time_s: Array, tensions_n: Array) -> Array:
        """The same (P, R, M) at R moments one after another."""
        return _one_by_one(self.step, time_s, tensions_n)


def _one_by_one(step: Callable[[float, Array], Array], time_s: Array, values: Array) -> Array:
    return np.stack([step(t, values[:, row]) for row, t in enumerate(time_s)], axis=1)


class Instant(Sensing):
    """A sensor without a state: a function of the time, s, and the tensions.

    It takes one moment and (P, M), or (R,) moments and (R, P, M).
    """

    def __init__(self, reading_n: Callable[[float | Array, Array], Array]) -> None:
        self._reading_n = reading_n

    def step(self, time_s: float, tensions_n: Array) -> Array:
        return self._reading_n(time_s, tensions_n)

    def along(self, time_s: Array, tensions_n: Array) -> Array:
        return np.moveaxis(self._reading_n(time_s, np.moveaxis(tensions_n, 1, 0)), 0, 1)


class Rest(NamedTuple):
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


class Pull(NamedTuple):
    """Tensions of cables of K pieces.

    Attributes:
        tensions_n: (..., K) of each piece, the actuator's first; zero in a slack cable.
        by_length_n_m: (..., K, K) derivative by the pieces' lengths.
    """

    tensions_n: Array
    by_length_n_m: Array


class Transmission:
    """Base: an ideal transmission. Holds the state of P arms side by side, from rest to rest.

    The search for the next rest asks for everything but `settle` at trial poses, as often as it
    needs; `settle` then gives what came of it, and only there may the state change.
    """

    def begin(self, mechanism: Mechanism, rest: Rest) -> None:
        """The state before the first sample; `rest` is that of the arm without the past."""

    def lengthening_m(self, time_s: float) -> Array | None:
        """(P, M) by which the cables are longer than when they were tensioned."""
        return None

    def hold(self, rest_m: Array, longer_m: Array) -> None:
        """Take what holds the cables, before a search; each (P, M).

        A cable is just slack where its spans add up to `rest_m`, which the actuators set, and
        to the length `longer_m` that it has gained since it was tensioned.
        """

    def pull(self, spans_m: Array, bends_rad: Array) -> Pull | None:
        """Tensions (P, M, 1 + N) at the actuator and in each span, if not all alike."""
        return None

    def balancing_turn_rad(
        self,
        spans_m: Array,
        bends_rad: Array,
        by_turn_m: Array,
        torque_n_m: Array,
        slope_n_m: Array,
    ) -> Array | None:
        """The turn (P, 2N) from a pose to the rest, if a transmission with `pull` can tell.

        Args:
            spans_m: (P, M, N) there.
            bends_rad: (P, M, N, 2).
            by_turn_m: (P, M, N, 2) derivative of the spans, each by the angles of its own joint.
            torque_n_m: (P, 2N) of all but the cables.
            slope_n_m: (P, 2N, 2N) its derivative, with what cables add that keep their tensions.
        """
        return None

    def joint_torque_n_m(self, angles_rad: Array) -> tuple[Array, Array] | None:
        """Torques (P, 2N) that resist, and their derivative by each joint's own angle."""
        return None

    def settle(self, rest: Rest) -> None:
        """Take the rest that was reached."""


class DryContact:
    """Contacts that carry a share between -1 and 1 of their limit, and keep it at rest.

    A share moves with the contact until it slips. Part of the contact is sharp, and yields evenly
    over `give` until it slips at once (Prandtl 1928); the rest is rounded, and nears its limit as
    exp(-moved / give) (Dahl, A solid friction model, Aerospace Corp. TOR-0158, 1968).
    """

    def __init__(self, give: Array, rounded: Array, start: Array) -> None:
        """Wherever they first rest they carry the share `start`.

        Args:
            give: (P, 1), in the unit of the positions (P, K) that `share` and `settle` take.
            rounded: (P, 1), of the contact, from 0 to 1.
            start: (P, K), from -1 to 1.
        """
        self._give, self._rounded = give, rounded
        self._sharp = self._round = start
        self._at: Array | None = None

    def share(self, at: Array) -> tuple[Array, Array]:
        """The share (P, K) at new positions, and its derivative by them."""
        if self._at is None:  # it yields nothing until the first rest is found
            return self._sharp, np.zeros_like(at)
        sharp, round_, free, full = self._moved(at - self._at)
        sharp_slope = np.abs(free) < 1.0
        round_slope = np.where(at == self._at, 1.0, np.abs(full - round_))
        return (
            (1.0 - self._rounded) * sharp + self._rounded * round_,
            ((1.0 - self._rounded) * sharp_slope + self._rounded * round_slope) / self._give,
        )

    def settle(self, at: Array) -> None:
        """Stay at these positions."""
        if self._at is not None:
            self._sharp, self._round, *_ = self._moved(at - self._at)
        self._at = at

    def _moved(self, by: Array) -> tuple[Array, Array, Array, Array]:
        moved = by / self._give
        free = self._sharp + moved
        full = np.sign(moved)
        round_ = full - (full - self._round) * np.exp(-np.abs(moved))
        return np.clip(free, -1.0, 1.0), np.where(moved == 0.0, self._round, round_), free, full
