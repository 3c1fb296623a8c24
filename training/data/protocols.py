"""What a dataset is made of: which contacts, at which poses, read by which sensor.

Two protocols, after the paper's section III-A. Both map the points of `design` (even cover of the
unit cube) to poses and contacts, so every combination of segment, direction, magnitude and pose
is approached at the same rate.

`SingleContact`
    at most one force, normal to the touched segment. *Exhaustive*: segments take equal shares,
    directions cover 360 degrees and magnitudes the force range, jointly and evenly.
`MultiContact`
    none to N forces at once, one on each touched segment: the set of configurations that the seed
    fixes. The number of contacts takes each value equally often and all sets of that many
    segments are equally likely. Forces stay within a narrower range (60 N by default), that of a
    wrapping grasp: several forces of 200 N on one side would mean a load that no grasp of such an
    arm exerts.

In both, contact-free samples belong to the data, by default 1/(N+1) of it, since *nothing
touches* is an answer.

Points come from a scrambled Sobol sequence in the unit cube, addressed by chunk.

Unlike a grid, such a sequence has no resolution to choose, and unlike a random draw it leaves no
holes: every dyadic box of volume 2^-m holds its share of each aligned block of 2^m points.

Work is cut into chunks of `CHUNK_SAMPLES`, whatever the number of workers. A chunk's points and
its random stream follow from the seed and the chunk's number alone; that is why one worker and
twenty write the same bytes.

With `randomise`, samples are drawn on arms with effects, so that a network learns arms that nobody
has measured yet (`drawn_entries`). Sizes are normal with their typical size for a standard
deviation (one-sided where they cannot be negative), places any of those that the effect can have;
manufacturing tolerances are everywhere at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from cablesense_sim.effects.effect import Parameter
from cablesense_sim.effects.registry import EffectEntry, known_effects
from cablesense_training.errors import DatasetError, require_within

CHUNK_SAMPLES = 2048
"""A power of two, so that every chunk is a balanced block of the sequence."""

MAX_SAMPLES = 2**30
"""The length of the sequence."""

DESIGN, NOISE, REDRAW, ARM = 0, 1, 2, 3
"""Purposes of random streams: points, sensor noise, points drawn again, arms with effects."""


def random_stream(purpose: int, seed: int, *place: int) -> np.random.Generator:
    """The stream of a purpose; `place` is the chunk and, for an arm, the block in it."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(purpose, *place)))


def unit_points(dimensions: int, seed: int, chunk: int) -> NDArray[np.float64]:
    """Points (CHUNK_SAMPLES, dimensions) in [0, 1) of the given chunk of the seed's sequence."""
    sequence = qmc.Sobol(dimensions, scramble=True, rng=random_stream(DESIGN, seed))
    if chunk:
        sequence.fast_forward(chunk * CHUNK_SAMPLES)
    return np.asarray(sequence.random(CHUNK_SAMPLES))


def chunk_sizes(samples: int) -> list[int]:
    """How many samples each chunk contributes: full chunks, then what is left."""
    full, rest = divmod(samples, CHUNK_SAMPLES)
    return [CHUNK_SAMPLES] * full + ([rest] if rest else [])


ALL = "all"
"""Stands for every effect that is known."""


def effect_names(randomise: str) -> list[str]:
    """The effects that an option means, in alphabetical order, each once.

    Raises:
        DatasetError: an effect that is not known, or none.
    """
    if not isinstance(randomise, str):
        raise DatasetError(f"randomise = {randomise!r}: must be names of effects, or {ALL}")
    names = [name.strip() for name in randomise.split(",")]
    if names == [ALL]:
        return list(known_effects())
    for name in names:
        if name not in known_effects():
            raise DatasetError(
                f"randomise = {randomise!r}: {name!r} is no effect; give {ALL}, or names from "
                f"{', '.join(known_effects())}, with commas between them"
            )
    return sorted(set(names))


def drawn_entries(
    names: list[str], segment_count: int, cable_count: int, rng: np.random.Generator
) -> list[EffectEntry]:
    """One arm's effects: each of `names` at a place of its own, tolerances at all of theirs."""
    entries = []
    for name in names:
        effect = known_effects()[name]
        places = effect.places(segment_count, cable_count)
        if not effect.tolerance:
            places = (places[int(rng.integers(len(places)))],)
        parameters = (*effect.parameters, *effect.history(segment_count, cable_count))
        entries += [
            EffectEntry(effect, place, {p.name: _value(p, rng) for p in parameters})
            for place in places
        ]
    return entries


def _value(parameter: Parameter, rng: np.random.Generator) -> float:
    if parameter.role == "shape":
        choices = parameter.trials or parameter.starts
        if choices:
            return float(rng.choice(choices))
        return float(rng.uniform(parameter.low, parameter.high))
    size = rng.normal(0.0, parameter.typical)
    if parameter.low == 0.0:
        size = abs(size)
    return float(np.clip(size, parameter.low, parameter.high))


Pose = Literal["straight", "random"]
MAX_FORCE_N = 10_000.0
MAX_POSE_RANGE_DEG = 45.0
MAX_TARE_SAMPLES = 10_000


class Cases(NamedTuple):
    """Poses and contacts of B samples on an arm of N segments.

    Attributes:
        command_rad: (B, 2N) commanded joint angles.
        contacts: (B, N) bool, whether a segment is touched.
        angles_deg: (B, N) contact angles, [0, 360); 0 where nothing touches.
        magnitudes_n: (B, N) force magnitudes; 0 where nothing touches.
    """

    command_rad: NDArray[np.float64]
    contacts: NDArray[np.bool_]
    angles_deg: NDArray[np.float64]
    magnitudes_n: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Protocol(ABC):
    """Options that every protocol has; refused with a `DatasetError` when out of range.

    Attributes:
        samples: number of samples.
        pose: `straight`, or `random` joint angles uniform within ± `pose_range_deg`.
        pose_range_deg: half range of every joint angle at random poses.
        noise: whether the arm's sensor noise and step act on readings and tare.
        tare_samples: number of unloaded readings averaged into a sample's tare; one tare per
            sample.
        force_low_n, force_high_n: magnitudes are uniform in this range.
        no_contact_fraction: share of contact-free samples; None stands for 1/(N+1).
        randomise: names of effects, with commas between them, or `all`: samples are drawn on arms
            that have these effects, each arm in other sizes and places. None: on the arm itself.
    """

    kind: ClassVar[str]

    samples: int = 5000
    pose: Pose = "straight"
    pose_range_deg: float = 10.0
    noise: bool = True
    tare_samples: int = 50
    force_low_n: float = 0.0
    force_high_n: float = 200.0
    no_contact_fraction: float | None = None
    randomise: str | None = None

    def __post_init__(self) -> None:
        require_within("samples", self.samples, 1, MAX_SAMPLES, whole=True)
        require_within("tare_samples", self.tare_samples, 1, MAX_TARE_SAMPLES, whole=True)
        require_within("pose_range_deg", self.pose_range_deg, 0.0, MAX_POSE_RANGE_DEG)
        require_within("force_low_n", self.force_low_n, 0.0, MAX_FORCE_N)
        require_within("force_high_n", self.force_high_n, 0.0, MAX_FORCE_N)
        if self.pose not in get_args(Pose):
            raise DatasetError(f"pose = {self.pose!r}: must be one of {', '.join(get_args(Pose))}")
        if not isinstance(self.noise, bool):
            raise DatasetError(f"noise = {self.noise!r}: must be true or false")
        if not self.force_low_n < self.force_high_n:
            raise DatasetError(
                f"force_low_n = {self.force_low_n:g} must be below "
                f"force_high_n = {self.force_high_n:g}"
            )
        if self.no_contact_fraction is not None:
            require_within("no_contact_fraction", self.no_contact_fraction, 0.0, 1.0)
        if self.randomise is not None:
            effect_names(self.randomise)

    def options(self) -> dict[str, Any]:
        """Kind and options as plain values; `protocol_from_options` is the inverse.

        An arm that is not randomised goes without saying, as it did before there was a choice.
        """
        said = {"kind": self.kind, **asdict(self)}
        if self.randomise is None:
            del said["randomise"]
        return said

    def contact_free_share(self, segment_count: int) -> float:
        """Share of contact-free samples on an arm of that many segments."""
        if self.no_contact_fraction is None:
            return 1.0 / (segment_count + 1)
        return self.no_contact_fraction

    def dimensions(self, segment_count: int) -> int:
        """Number of coordinates that `cases` takes from each point."""
        joints = 2 * segment_count if self.pose == "random" else 0
        return self._contact_dimensions(segment_count) + joints

    def cases(self, segment_count: int, points: NDArray[np.float64]) -> Cases:
        """The poses and contacts at points (B, dimensions) of the unit cube."""
        split = self._contact_dimensions(segment_count)
        if self.pose == "random":
            command = np.deg2rad(self.pose_range_deg) * (2.0 * points[:, split:] - 1.0)
        else:
            command = np.zeros((len(points), 2 * segment_count))
        contacts, turn, share = self._contacts(segment_count, points[:, :split])
        magnitude = self.force_low_n + (self.force_high_n - self.force_low_n) * share
        return Cases(
            command_rad=command,
            contacts=contacts,
            angles_deg=np.where(contacts, 360.0 * turn, 0.0),
            magnitudes_n=np.where(contacts, magnitude, 0.0),
        )

    @abstractmethod
    def _contact_dimensions(self, segment_count: int) -> int:
        """Number of coordinates that the contacts take."""

    @abstractmethod
    def _contacts(
        self, segment_count: int, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
        """Segments touched (B, N); direction and magnitude in [0, 1), broadcast to (B, N)."""


@dataclass(frozen=True, kw_only=True)
class SingleContact(Protocol):
    """At most one contact; coordinates are (segment, direction, magnitude), then the joints."""

    kind: ClassVar[str] = "single"

    def _contact_dimensions(self, segment_count: int) -> int:
        return 3

    def _contacts(
        self, segment_count: int, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
        segment = _number_touched(
            points[:, 0], self.contact_free_share(segment_count), segment_count
        )
        contacts = segment[:, None] == np.arange(1, segment_count + 1)
        return contacts, points[:, 1:2], points[:, 2:3]


@dataclass(frozen=True, kw_only=True)
class MultiContact(Protocol):
    """None to `max_contacts` contacts (None stands for N) on different segments.

    Coordinates are the number of contacts, then per segment a rank (the lowest ranks are
    touched), a direction and a magnitude, then the joints.
    """

    kind: ClassVar[str] = "multi"

    force_high_n: float = 60.0
    max_contacts: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_contacts is not None:
            require_within("max_contacts", self.max_contacts, 1, 1_000, whole=True)

    def _contact_dimensions(self, segment_count: int) -> int:
        return 1 + 3 * segment_count

    def _contacts(
        self, segment_count: int, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
        most = segment_count if self.max_contacts is None else self.max_contacts
        if most > segment_count:
            raise DatasetError(
                f"max_contacts = {most}: the arm has {segment_count} segments, "
                f"so at most {segment_count} can be touched at once"
            )
        number = _number_touched(points[:, 0], self.contact_free_share(segment_count), most)
        ranks, turn, share = np.split(points[:, 1:], 3, axis=1)
        place = np.argsort(np.argsort(ranks, axis=1, kind="stable"), axis=1, kind="stable")
        return place < number[:, None], turn, share


PROTOCOLS: dict[str, type[Protocol]] = {p.kind: p for p in (SingleContact, MultiContact)}
"""Protocols by the name that commands and files use."""


def protocol_from_options(options: dict[str, Any]) -> Protocol:
    """The protocol with the options that `Protocol.options` gave.

    Raises:
        DatasetError: unknown protocol, unknown option, or a value out of range.
    """
    given = dict(options)
    kind = given.pop("kind", None)
    if not isinstance(kind, str) or kind not in PROTOCOLS:
        raise DatasetError(f"protocol {kind!r}: must be one of {', '.join(PROTOCOLS)}")
    valid = [field.name for field in fields(PROTOCOLS[kind])]
    unknown = sorted(set(given) - set(valid))
    if unknown:
        raise DatasetError(
            f"protocol {kind}: unknown option {unknown[0]!r}; valid options: {', '.join(valid)}"
        )
    return PROTOCOLS[kind](**given)


def _number_touched(
    coordinate: NDArray[np.float64], contact_free: float, highest: int
) -> NDArray[np.int64]:
    """0 for the contact-free share of [0, 1), else 1 … highest in equal shares."""
    number = np.zeros(len(coordinate), dtype=np.int64)
    touched = coordinate >= contact_free
    place = (coordinate[touched] - contact_free) / (1.0 - contact_free)
    number[touched] = 1 + np.minimum(np.floor(place * highest), highest - 1)
    return number
