"""What a dataset holds, in a few figures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cablesense_training.data.dataset import Dataset


@dataclass(frozen=True)
class Summary:
    """Figures of a dataset.

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
    """The figures of a dataset."""
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
    """The figures of several parts together; there must be at least one."""
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
