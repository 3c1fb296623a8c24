"""A dataset in memory: tension differences of one arm with the contacts that caused them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.mechanism import Mechanism
from cablesense_training.data.protocols import Protocol, SingleContact
from cablesense_training.errors import DatasetError


def contact_forces_n(
    mechanism: Mechanism,
    command_rad: Array,
    angles_deg: Array,
    magnitudes_n: Array,
    along_n: Array | None = None,
) -> Array:
    """Contact forces (…, N, 3) in base axes for angles and magnitudes (…, N), one a segment.

    Each is normal to its segment at the commanded angles (…, 2N), but for a part `along_n` (…, N)
    towards its end.
    """
    axis, left, up = np.moveaxis(kinematics.segment_rotations(mechanism, command_rad), -1, 0)
    theta = np.deg2rad(angles_deg)[..., None]
    forces = (np.sin(theta) * left + np.cos(theta) * up) * magnitudes_n[..., None]
    return forces if along_n is None else forces + axis * along_n[..., None]


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
        """Parts of one run, in the order given; there must be at least one."""
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in cls.array_names()
        }
        return replace(parts[0], **arrays)


@dataclass(frozen=True, eq=False)
class Dataset(RunRows):
    """B samples of an arm with N segments and M cables. Rows of all arrays belong together.

    Labels are 0 where nothing touches.

    Attributes:
        protocol: how they were drawn; its `samples` counts the whole run, this may be a part.
        sample_id: (B,) number of each sample in the run, from 0.
        command_rad: (B, 2N) commanded joint angles.
        tension_difference_n: (B, M) reading minus `unloaded_n`.
        unloaded_n: (B, M) the tare: mean of the unloaded arm's readings at the same command.
        contacts: (B, N) bool, whether a segment is touched.
        angles_deg: (B, N) contact angle [0, 360) in the plane normal to the segment at the
            commanded angles, from +z towards +y.
        magnitudes_n: (B, N) forces normal to the segment.
        places_m: (B, N) distances of the contacts from the segments' joint centres.
        along_n: (B, N) forces along the segments at the commanded angles, towards their ends.
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
    places_m: Array
    along_n: Array
    slack_cables: NDArray[np.int64]
    redrawn: NDArray[np.int64]

    def __post_init__(self) -> None:
        rows = len(self.sample_id)
        n = self.arm.segment_count
        m = self.arm.cable_count
        widths = {"command_rad": 2 * n, "tension_difference_n": m, "unloaded_n": m}
        labels = ("contacts", "angles_deg", "magnitudes_n", "places_m", "along_n")
        widths |= dict.fromkeys(labels, n)
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
        labels = self.angles_deg, self.magnitudes_n, self.along_n
        return contact_forces_n(mechanism_of(self.arm), self.command_rad, *labels)

    @cached_property
    def local_forces_n(self) -> Array:
        """(B, N, 3) the same along the axes that each segment has at the commanded angles."""
        theta = np.deg2rad(self.angles_deg)
        y = self.magnitudes_n * np.sin(theta)
        z = self.magnitudes_n * np.cos(theta)
        return np.stack([self.along_n, y, z], axis=-1)

    @cached_property
    def segment(self) -> NDArray[np.int64]:
        """(B,) touched segment, 1 … N, or 0 for none. Single contact only."""
        contacts = self._single("contacts")
        return np.where(contacts.any(axis=1), contacts.argmax(axis=1) + 1, 0)

    @cached_property
    def angle_deg(self) -> Array:
        """(B,) contact angle, 0 where nothing touches. Single contact only."""
        return self._single("angles_deg").sum(axis=1)

    @cached_property
    def magnitude_n(self) -> Array:
        """(B,) force magnitude, 0 where nothing touches. Single contact only."""
        return self._single("magnitudes_n").sum(axis=1)

    def _single(self, name: str) -> NDArray[Any]:
        if not isinstance(self.protocol, SingleContact):
            raise DatasetError(
                "segment, angle_deg and magnitude_n describe a single contact, and this dataset "
                f"follows protocol {self.protocol.kind}; use contacts, angles_deg and magnitudes_n"
            )
        return np.asarray(getattr(self, name))


@dataclass(frozen=True)
class Summary:
    """What a dataset holds: its samples by kind, and its forces.

    Attributes:
        contacts_per_segment: of segment 1 … N; with several at once, each counts.
        weakest_n, strongest_n: range of the forces normal to the segments; 0 without a contact.
        most_along_n: largest force along a segment, either way.
        redrawn_rows: samples drawn again because the first draw lay beyond the arm.
    """

    rows: int
    contact_free: int
    contacts_per_segment: tuple[int, ...]
    several_contacts: int
    weakest_n: float
    strongest_n: float
    most_along_n: float
    slack_rows: int
    redrawn_rows: int


def summarise(parts: Iterable[Dataset]) -> Summary:
    """The summary of all parts of a run; there must be at least one."""
    counts = []
    forces = []
    most_along_n = 0.0
    for part in parts:
        number = part.contacts.sum(axis=1)
        kinds = [number == 0, number > 1, part.slack_cables > 0, part.redrawn > 0]
        flags = np.column_stack([np.ones(len(part), bool), *kinds, part.contacts])
        counts.append(flags.sum(axis=0))
        forces.append(part.magnitudes_n[part.contacts])
        most_along_n = max(most_along_n, float(np.abs(part.along_n).max()))
    rows, free, several, slack, redrawn, *per_segment = np.sum(counts, axis=0).tolist()
    force_n = np.concatenate(forces)
    return Summary(
        rows=rows,
        contact_free=free,
        contacts_per_segment=tuple(per_segment),
        several_contacts=several,
        weakest_n=float(force_n.min()) if force_n.size else 0.0,
        strongest_n=float(force_n.max(initial=0.0)),
        most_along_n=most_along_n,
        slack_rows=slack,
        redrawn_rows=redrawn,
    )
