"""Protocols of datasets: contacts and poses at points of the unit cube, arms with effects.

Points and random streams follow from the seed and the chunk's number alone, so the number of
workers does not change a byte. docs/data.md explains the protocols.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import asdict, fields
from itertools import combinations
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    model_validator,
)
from pydantic.dataclasses import dataclass
from scipy.stats import qmc

from cablesense_base import Array
from cablesense_base.plain_yaml import describe_problem
from cablesense_sim.arm import Arm, of_each_segment
from cablesense_sim.effects.effect import Parameter
from cablesense_sim.effects.registry import EffectEntry, known_effects
from cablesense_sim.load_capacity import contact_range_n, pose_range_deg
from cablesense_sim.touch import touched_places
from cablesense_training.errors import DatasetError

CHUNK_SAMPLES = 2048
"""A power of two, so that every chunk is a balanced block of the Sobol sequence."""

DESIGN = 0
"""Random stream of points,"""
NOISE = 1
"""of sensor noise,"""
REDRAW = 2
"""of points drawn again,"""
ARM = 3
"""and of arms with effects."""


def random_stream(purpose: int, seed: int, *place: int) -> np.random.Generator:
    """The stream of a purpose; `place` is the chunk and, for an arm, the block in it."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(purpose, *place)))


def unit_points(dimensions: int, seed: int, chunk: int) -> Array:
    """Points (CHUNK_SAMPLES, dimensions) in [0, 1) of a chunk of the seed's Sobol sequence."""
    sequence = qmc.Sobol(dimensions, scramble=True, rng=random_stream(DESIGN, seed))
    if chunk:
        sequence.fast_forward(chunk * CHUNK_SAMPLES)
    return np.asarray(sequence.random(CHUNK_SAMPLES))


def chunk_sizes(samples: int, most: int = CHUNK_SAMPLES) -> list[int]:
    """How many samples each chunk contributes: `most`, then the rest."""
    full, rest = divmod(samples, most)
    return [most] * full + [rest] * (rest > 0)


def effect_names(randomise: str) -> list[str]:
    """The effects that an option means, in alphabetical order; `all` is all that change samples.

    Raises:
        DatasetError: an effect that is not known, or none.
    """
    names = {name.strip() for name in randomise.split(",")}
    known = [name for name, effect in known_effects().items() if effect.acts_on != "load"]
    if names == {"all"}:
        return known
    if unknown := sorted(names.difference(known)):
        raise DatasetError(
            f"randomise = {randomise!r}: {unknown[0]!r} is no effect; give all, or names from "
            f"{', '.join(known)}, with commas between them"
        )
    return sorted(names)


def drawn_entries(
    names: list[str], segment_count: int, cable_count: int, rng: np.random.Generator
) -> list[EffectEntry]:
    """One arm's effects: each of `names` at one random place, tolerances at all places."""
    entries = []
    for name in names:
        effect = known_effects()[name]
        places = effect.places(segment_count, cable_count)
        if not effect.tolerance:
            places = (places[int(rng.integers(len(places)))],)
        parameters = (*effect.parameters, *effect.history(segment_count, cable_count))
        entries += [
            EffectEntry(effect, place, {p.name: _drawn_value(p, rng) for p in parameters})
            for place in places
        ]
    return entries


def _drawn_value(parameter: Parameter, rng: np.random.Generator) -> float:
    """Normal with the typical size for a standard deviation, one-sided from a low bound of 0."""
    if parameter.role == "shape":
        choices = parameter.trials or parameter.starts
        if choices:
            return float(rng.choice(choices))
        return float(rng.uniform(parameter.low, parameter.high))
    size = rng.normal(0.0, parameter.typical)
    if parameter.low == 0.0:
        size = abs(size)
    return float(np.clip(size, parameter.low, parameter.high))


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a run; refused with a `DatasetError` when unknown or out of range."""

    __pydantic_config__ = ConfigDict(strict=True, allow_inf_nan=False, extra="forbid")

    @model_validator(mode="wrap")
    @classmethod
    def _refused_by_name(cls, given: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return handler(given)
        except ValidationError as error:
            problem = error.errors(include_url=False)[0]
            if problem["type"] == "unexpected_keyword_argument":
                valid = ", ".join(field.name for field in fields(cls))
                raise DatasetError(
                    f"unknown option {problem['loc'][0]!r}; valid options: {valid}"
                ) from error
            raise DatasetError(describe_problem(error, BaseModel)) from error


Pose = Literal["straight", "random"]
PoseRange = Annotated[float, Field(ge=0.0, le=45.0)]
Readings = Annotated[int, Field(ge=1, le=10_000)]
_Force = Annotated[float, Field(ge=0.0, le=10_000.0)]


class _Touches(NamedTuple):
    """Contacts (B, N) of B samples, as shares of the circle and of the ranges, in [0, 1).

    They broadcast to (B, N). `along` is the axial over the lateral force.
    """

    contacts: NDArray[np.bool_]
    turn: Array
    force: Array
    place: Array | float = 0.0
    along: Array | float = 0.0


class Cases(NamedTuple):
    """Poses and contacts of B samples, as a `Dataset` has them."""

    command_rad: Array
    contacts: NDArray[np.bool_]
    angles_deg: Array
    magnitudes_n: Array
    places_m: Array
    along_n: Array


@dataclass(frozen=True, kw_only=True)
class Protocol(Options, ABC):
    """Options that every protocol has.

    Attributes:
        pose: `straight`, or `random` joint angles uniform within ± `pose_range_deg`.
        noise: whether the arm's sensor noise and step act on readings and tare.
        tare_samples: number of unloaded readings averaged into each sample's own tare.
        force_low_n, force_high_n: magnitudes are uniform in this range.
        no_contact_fraction: share of contact-free samples; None stands for 1/(N+1).
        randomise: names of effects, with commas between them, or `all`: samples are drawn on arms
            that have these effects, each arm in other sizes and places. None: on the arm itself.
    """

    kind: ClassVar[str]
    anywhere: ClassVar[bool] = False
    """Whether contacts are at drawn places, not at the contact points of the arm file."""

    samples: Annotated[int, Field(ge=1, le=2**30)] = 5000
    pose: Pose = "straight"
    pose_range_deg: PoseRange = 10.0
    noise: bool = True
    tare_samples: Readings = 50
    force_low_n: _Force = 0.0
    force_high_n: _Force = 200.0
    no_contact_fraction: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    randomise: str | None = None

    def __post_init__(self) -> None:
        if not self.force_low_n < self.force_high_n:
            raise DatasetError(
                f"force_low_n = {self.force_low_n:g} must be below "
                f"force_high_n = {self.force_high_n:g}"
            )
        if self.randomise is not None:
            effect_names(self.randomise)

    def options(self) -> dict[str, Any]:
        """Kind and options as plain values; `protocol_from_options` is the inverse."""
        options = {"kind": self.kind, **asdict(self)}
        if self.randomise is None:  # files are as before there was a choice
            del options["randomise"]
        return options

    def touched_m(self, arm: Arm) -> Array:
        """(N, 2) ranges of the places of contacts, from the segments' joint centres."""
        points = np.array(of_each_segment(arm.segments.contact_m, arm.segment_count))
        return np.stack([points, points], axis=1)

    def dimensions(self, segment_count: int) -> int:
        """Number of coordinates that `cases` takes from each point."""
        joints = 2 * segment_count if self.pose == "random" else 0
        return self._contact_dimensions(segment_count) + joints

    def cases(self, touched_m: Array, points: Array) -> Cases:
        """The poses and contacts at points (B, dimensions) of the unit cube.

        Contacts are within `touched_m` (N, 2) of the segments.
        """
        segment_count = len(touched_m)
        split = self._contact_dimensions(segment_count)
        if self.pose == "random":
            command = np.deg2rad(self.pose_range_deg) * (2.0 * points[:, split:] - 1.0)
        else:
            command = np.zeros((len(points), 2 * segment_count))
        touches = self._contacts(segment_count, points[:, :split])
        contacts, low, high = touches.contacts, *touched_m.T
        magnitude = self.force_low_n + (self.force_high_n - self.force_low_n) * touches.force
        return Cases(
            command_rad=command,
            contacts=contacts,
            angles_deg=np.where(contacts, 360.0 * touches.turn, 0.0),
            magnitudes_n=np.where(contacts, magnitude, 0.0),
            places_m=np.where(contacts, low + (high - low) * touches.place, 0.0),
            along_n=np.where(contacts, touches.along * magnitude, 0.0),
        )

    @abstractmethod
    def _contact_dimensions(self, segment_count: int) -> int:
        """Number of coordinates that the contacts take."""

    @abstractmethod
    def _contacts(self, segment_count: int, points: Array) -> _Touches:
        """The contacts at their coordinates (B, dimensions)."""

    def _number(self, coordinate: Array, segment_count: int, highest: int) -> NDArray[np.int64]:
        """0 for the contact-free share of [0, 1), else 1 … highest in equal shares."""
        touched, rest = self._touched(coordinate, segment_count)
        return np.where(touched, 1 + _of_equal_shares(rest, highest), 0)

    def _touched(self, coordinate: Array, segment_count: int) -> tuple[NDArray[np.bool_], Array]:
        """Which samples (B,) are touched, and what is left of their coordinate, in [0, 1)."""
        free = self.no_contact_fraction
        if free is None:
            free = 1.0 / (segment_count + 1)
        touched = coordinate >= free
        rest = np.zeros_like(coordinate)
        rest[touched] = (coordinate[touched] - free) / (1.0 - free)
        return touched, rest


def _of_equal_shares(coordinate: Array, count: int) -> NDArray[np.int64]:
    """Which of `count` equal shares of [0, 1) each coordinate is in, from 0 on."""
    return np.minimum(np.floor(coordinate * count), count - 1).astype(np.int64)


@dataclass(frozen=True, kw_only=True)
class SingleContact(Protocol):
    """At most one contact; coordinates are (segment, direction, magnitude), then the joints."""

    kind: ClassVar[str] = "single"

    def _contact_dimensions(self, segment_count: int) -> int:
        return 3

    def _contacts(self, segment_count: int, points: Array) -> _Touches:
        segment = self._number(points[:, 0], segment_count, segment_count)
        contacts = segment[:, None] == np.arange(1, segment_count + 1)
        return _Touches(contacts, points[:, 1:2], points[:, 2:3])


@dataclass(frozen=True, kw_only=True)
class MultiContact(Protocol):
    """Zero to `max_contacts` contacts (None means N) on different segments.

    Coordinates are the number of contacts, then per segment a rank (the lowest ranks are
    touched), a direction and a magnitude, then the joints.
    """

    kind: ClassVar[str] = "multi"

    force_high_n: _Force = 60.0
    max_contacts: Annotated[int, Field(ge=1, le=1_000)] | None = None

    def _contact_dimensions(self, segment_count: int) -> int:
        return 1 + 3 * segment_count

    def _contacts(self, segment_count: int, points: Array) -> _Touches:
        most = segment_count if self.max_contacts is None else self.max_contacts
        if most > segment_count:
            raise DatasetError(
                f"max_contacts = {most}: the arm has {segment_count} segments, "
                f"so at most {segment_count} can be touched at once"
            )
        number = self._number(points[:, 0], segment_count, most)
        ranks, turn, share = np.split(points[:, 1:], 3, axis=1)
        place = np.argsort(np.argsort(ranks, axis=1, kind="stable"), axis=1, kind="stable")
        return _Touches(place < number[:, None], turn, share)


@dataclass(frozen=True, kw_only=True)
class AnywhereContact(Protocol):
    """One contact or two, anywhere along the reach of the arm, with a force in three dimensions.

    Coordinates are the set of touched segments, then direction, magnitude, place and axial share
    of the first contact and of the second, then the joints. Each pair of segments is equally
    likely; the forces of two contacts are in the lower half of the range.

    Attributes:
        two_contacts_fraction: share of the touched samples that have contacts on two segments.
        axial_share: the axial force is uniform within plus or minus this share of the lateral one.
    """

    kind: ClassVar[str] = "anywhere"
    anywhere: ClassVar[bool] = True

    two_contacts_fraction: Annotated[float, Field(ge=0.0, le=1.0)] = 0.15
    axial_share: Annotated[float, Field(ge=0.0, le=2.0)] = 0.3

    def touched_m(self, arm: Arm) -> Array:
        """(N, 2) where the arm file says that it is touched."""
        return touched_places(arm).touched_m

    def _contact_dimensions(self, segment_count: int) -> int:
        return 1 + 2 * 4

    def _contacts(self, segment_count: int, points: Array) -> _Touches:
        pairs = np.array([*combinations(range(segment_count), 2)], dtype=np.int64).reshape(-1, 2)
        two = self.two_contacts_fraction if len(pairs) else 0.0
        touched, rest = self._touched(points[:, 0], segment_count)
        several = touched & (rest < two)
        single = touched & ~several
        first, second = np.full((2, len(points)), -1)
        first[single] = _of_equal_shares((rest[single] - two) / (1.0 - two), segment_count)
        pair = _of_equal_shares(rest[several] / two, len(pairs))
        first[several], second[several] = pairs[pair].T
        segments = np.arange(segment_count)
        is_second = second[:, None] == segments
        of_each = points[:, 1:].reshape(-1, 2, 4)
        turn, force, place, along = np.where(
            is_second, of_each[:, 1].T[..., None], of_each[:, 0].T[..., None]
        )
        return _Touches(
            contacts=(first[:, None] == segments) | is_second,
            turn=turn,
            force=np.where(several[:, None], 0.5 * force, force),
            place=place,
            along=self.axial_share * (2.0 * along - 1.0),
        )


_PROTOCOLS = {
    protocol.kind: protocol for protocol in (SingleContact, MultiContact, AnywhereContact)
}


def protocol_from_options(options: dict[str, Any], arm: Arm | None = None) -> Protocol:
    """The protocol with the options that `Protocol.options` gave, and those `borne_by` an arm.

    Raises:
        DatasetError: unknown protocol, unknown option, or a value out of range.
        WeakArmError: the arm cannot stand.
    """
    protocol_options = dict(options)
    kind = protocol_options.pop("kind", None)
    if not isinstance(kind, str) or kind not in _PROTOCOLS:
        raise DatasetError(f"protocol {kind!r}: must be one of {', '.join(_PROTOCOLS)}")
    protocol = _PROTOCOLS[kind]
    if arm is not None:
        at_once = protocol_options.get("max_contacts") or arm.segment_count
        contacts = at_once if protocol is MultiContact else 1
        if protocol.anywhere:
            arm = _touched_at_its_end(arm)
        protocol_options = borne_by(arm, protocol, protocol_options, contacts)
    return protocol(**protocol_options)


def borne_by(arm: Arm, protocol: Any, given: dict[str, Any], contacts: int = 1) -> dict[str, Any]:
    """Options with the largest force and pose, where not given, as usual or as the arm bears."""
    options = dict(given)
    if "force_high_n" not in options:
        options["force_high_n"] = contact_range_n(arm, protocol.force_high_n, contacts)
    if "pose_range_deg" not in options and options.get("pose", protocol.pose) == "random":
        usual_deg = protocol.pose_range_deg
        force_n = options["force_high_n"]
        options["pose_range_deg"] = pose_range_deg(arm, usual_deg, force_n)
    return options


def _touched_at_its_end(arm: Arm) -> Arm:
    """The arm with its contact points where touch bends it most: at the far ends of each."""
    ends = touched_places(arm).touched_m[:, 1].tolist()
    return arm.model_copy(update={"segments": arm.segments.model_copy(update={"contact_m": ends})})
