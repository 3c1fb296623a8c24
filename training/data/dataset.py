"""A dataset in memory: tension differences of one arm with the contacts that caused them.

`contact_forces_n` gives the forces of rows of labels, `summarise` what a dataset holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
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
class RunRows:
    """Rows of a run that arm, protocol and seed determine; further fields are arrays of them."""

    arm: Arm
    protocol: Any
    seed: int

    @classmethod
    def array_names(cls) -> list[str]:
        """Names of the arrays that have one entry a row."""
        return [f.name for f in fields(cls) if f.name not in ("arm", "protocol", "seed")]

    def select(self, rows: Any) -> Self:
        """The given rows (slice, mask or row numbers), in that order."""
        return replace(self, **{name: getattr(self, name)[rows] for name in self.array_names()})

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """Parts of one run, in the order given.

        Raises:
            DatasetError: no parts, or parts of different arms, protocols or seeds.
        """
        if not parts:
            raise DatasetError("a run needs at least one part")
        first = parts[0]
        for part in parts[1:]:
            if (part.arm, part.protocol, part.seed) != (first.arm, first.protocol, first.seed):
                raise DatasetError(
                    f"parts of different runs: {first.arm.identity}, {first.protocol}, "
                    f"seed {first.seed} and {part.arm.identity}, {part.protocol}, seed {part.seed}"
                )
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in cls.array_names()
        }
        return replace(first, **arrays)


@dataclass(frozen=True, eq=False)
class Dataset(RunRows):
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

    protocol: Protocol
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
        rows, n, m = len(self.sample_id), self.arm.segment_count, self.arm.cable_count
        widths = {"command_rad": 2 * n, "tension_difference_n": m, "unloaded_n": m}
        widths |= dict.fromkeys(("contacts", "angles_deg", "magnitudes_n"), n)
        for name in self.array_names():
            shape = (rows, widths[name]) if name in widths else (rows,)
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

    def parts(self, rows: int) -> Iterator[Dataset]:
        """The dataset in consecutive parts of at most `rows` samples."""
        for start in range(0, len(self), rows):
            yield self.select(slice(start, start + rows))


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


def summarise(parts: Iterable[Dataset]) -> Summary:
    """The summary of all parts of a run; there must be at least one."""
    counts, per_segment, ranges = [], [], []
    for part in parts:
        free = ~part.contacts.any(axis=1)
        counts.append(
            [len(part), free.sum(), (part.slack_cables > 0).sum(), (part.redrawn > 0).sum()]
        )
        per_segment.append(part.contacts.sum(axis=0))
        forces = part.magnitudes_n[part.contacts]
        if forces.size:
            ranges += [forces.min(), forces.max()]
    rows, contact_free, slack_rows, redrawn_rows = np.sum(counts, axis=0).tolist()
    return Summary(
        rows=rows,
        contact_free=contact_free,
        contacts_per_segment=tuple(np.sum(per_segment, axis=0).tolist()),
        weakest_n=float(min(ranges, default=0.0)),
        strongest_n=float(max(ranges, default=0.0)),
        slack_rows=slack_rows,
        redrawn_rows=redrawn_rows,
    )
