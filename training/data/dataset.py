"""A dataset in memory: tension differences of one arm with the contacts that caused them.

`contact_forces_n` gives the forces of rows of labels, `summarise` what a dataset holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism
from cablesense_training.data.protocols import Protocol, SingleContact
from cablesense_training.errors import DatasetError


def contact_forces_n(
    mechanism: Mechanism, command_rad: Array, angles_deg: Array, magnitudes_n: Array
) -> Array:
    """Contact forces (B, N, 3) in base axes for angles and magnitudes (B, N), one a segment.

    Each is normal to its segment at the commanded angles (B, 2N); where the magnitude is 0, so is
    the force.
    """
    forces = np.zeros((len(command_rad), mechanism.segment_count, 3))
    for n in range(mechanism.segment_count):
        rows = np.flatnonzero(magnitudes_n[:, n])
        segment = np.full(len(rows), n + 1)
        angle, magnitude = angles_deg[rows, n], magnitudes_n[rows, n]
        forces[rows] += normal_force_n(mechanism, command_rad[rows], segment, angle, magnitude)
    return forces


@dataclass(frozen=True, eq=False)
class Dataset:
    """B samples of an arm with N segments and M cables. Rows of all arrays belong together.

    Attributes:
        arm: the arm the samples come from.
        protocol: how they were drawn (its `samples` counts the whole run, of which this may be a
            part).
        seed: seed of the run.
        sample_id: (B,) number of each sample in the run, from 0.
        command_rad: (B, 2N) commanded joint angles.
        tension_difference_n: (B, M) reading minus `unloaded_n`.
        unloaded_n: (B, M) the tare: mean of the unloaded arm's readings at the same command.
        contacts: (B, N) bool, whether a segment is touched.
        angles_deg: (B, N) contact angle [0, 360) in the plane normal to the segment at the
            commanded angles, from +z towards +y; 0 where nothing touches.
        magnitudes_n: (B, N) force magnitudes; 0 where nothing touches.
        slack_cables: (B,) number of cables that hang slack under the load.
        redrawn: (B,) how often the case was drawn again because it lay beyond the arm.
    """

    arm: Arm
    protocol: Protocol
    seed: int
    sample_id: NDArray[np.int64]
    command_rad: Array
    tension_difference_n: Array
    unloaded_n: Array
    contacts: NDArray[np.bool_]
    angles_deg: Array
    magnitudes_n: Array
    slack_cables: NDArray[np.int64]
    redrawn: NDArray[np.int64]

    def __post_init__(self) -> None:
        n, m = self.arm.segment_count, self.arm.cable_count
        rows = len(self.sample_id)
        shapes: dict[str, tuple[int, ...]] = {
            "sample_id": (rows,),
            "command_rad": (rows, 2 * n),
            "tension_difference_n": (rows, m),
            "unloaded_n": (rows, m),
            "contacts": (rows, n),
            "angles_deg": (rows, n),
            "magnitudes_n": (rows, n),
            "slack_cables": (rows,),
            "redrawn": (rows,),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise DatasetError(
                    f"{name} has shape {getattr(self, name).shape}; {rows} samples of arm "
                    f"{self.arm.identity} need {shape}"
                )

    def __len__(self) -> int:
        return len(self.sample_id)

    @cached_property
    def forces_n(self) -> Array:
        """(B, N, 3) forces of the environment, base axes; zero where nothing touches."""
        mechanism = mechanism_of(self.arm)
        return contact_forces_n(mechanism, self.command_rad, self.angles_deg, self.magnitudes_n)

    @cached_property
    def segment(self) -> NDArray[np.int64]:
        """(B,) touched segment, 1 … N, or 0 for none. Single contact only."""
        self._require_single("segment")
        return np.where(self.contacts.any(axis=1), self.contacts.argmax(axis=1) + 1, 0)

    @cached_property
    def angle_deg(self) -> Array:
        """(B,) contact angle, 0 where nothing touches. Single contact only."""
        self._require_single("angle_deg")
        return self.angles_deg.sum(axis=1)

    @cached_property
    def magnitude_n(self) -> Array:
        """(B,) force magnitude, 0 where nothing touches. Single contact only."""
        self._require_single("magnitude_n")
        return self.magnitudes_n.sum(axis=1)

    def _require_single(self, name: str) -> None:
        if not isinstance(self.protocol, SingleContact):
            raise DatasetError(
                f"{name} describes a single contact, and this dataset follows protocol "
                f"{self.protocol.kind}; use contacts, angles_deg and magnitudes_n"
            )

    def select(self, rows: Any) -> Dataset:
        """The given rows (slice, mask or row numbers), in that order."""
        return replace(self, **{name: getattr(self, name)[rows] for name in ARRAY_NAMES})

    @classmethod
    def concatenate(cls, parts: Sequence[Dataset]) -> Dataset:
        """Parts of one run, in the order given.

        Raises:
            DatasetError: no parts, or parts of different arms, protocols or seeds.
        """
        if not parts:
            raise DatasetError("a dataset needs at least one part")
        first = parts[0]
        for part in parts[1:]:
            same = (part.arm, part.protocol, part.seed) == (first.arm, first.protocol, first.seed)
            if not same:
                raise DatasetError(
                    f"parts of different runs: {first.arm.identity}, {first.protocol}, "
                    f"seed {first.seed} and {part.arm.identity}, {part.protocol}, seed {part.seed}"
                )
        arrays: dict[str, Any] = {
            n: np.concatenate([getattr(p, n) for p in parts]) for n in ARRAY_NAMES
        }
        return replace(first, **arrays)

    def parts(self, rows: int) -> Iterator[Dataset]:
        """The dataset in consecutive parts of at most `rows` samples."""
        for start in range(0, len(self), rows):
            yield self.select(slice(start, start + rows))


ARRAY_NAMES = tuple(f.name for f in fields(Dataset) if f.name not in ("arm", "protocol", "seed"))
"""Names of the arrays that have one row per sample."""


@dataclass(frozen=True)
class Summary:
    """What a dataset holds.

    Attributes:
        rows: number of samples.
        contact_free: samples without contact.
        contacts_per_segment: contacts on segment 1 … N; with several at once, each counts.
        weakest_n, strongest_n: range of the contact forces; 0 when there is no contact.
        slack_rows: samples with at least one slack cable.
        redrawn_rows: samples drawn again because the first draw lay beyond the arm.
    """

    rows: int
    contact_free: int
    contacts_per_segment: tuple[int, ...]
    weakest_n: float
    strongest_n: float
    slack_rows: int
    redrawn_rows: int


def summarise(dataset: Dataset) -> Summary:
    """What a dataset holds."""
    contacts = dataset.contacts
    forces = dataset.magnitudes_n[contacts]
    return Summary(
        rows=len(dataset),
        contact_free=int((~contacts.any(axis=1)).sum()),
        contacts_per_segment=tuple(int(count) for count in contacts.sum(axis=0)),
        weakest_n=float(forces.min()) if forces.size else 0.0,
        strongest_n=float(forces.max()) if forces.size else 0.0,
        slack_rows=int((dataset.slack_cables > 0).sum()),
        redrawn_rows=int((dataset.redrawn > 0).sum()),
    )


def combine(summaries: Iterable[Summary]) -> Summary:
    """What several parts hold together; there must be at least one."""
    parts = list(summaries)
    touched = [p for p in parts if p.rows > p.contact_free]
    per_segment = np.sum([p.contacts_per_segment for p in parts], axis=0)
    return Summary(
        rows=sum(p.rows for p in parts),
        contact_free=sum(p.contact_free for p in parts),
        contacts_per_segment=tuple(int(count) for count in per_segment),
        weakest_n=min((p.weakest_n for p in touched), default=0.0),
        strongest_n=max((p.strongest_n for p in touched), default=0.0),
        slack_rows=sum(p.slack_rows for p in parts),
        redrawn_rows=sum(p.redrawn_rows for p in parts),
    )
