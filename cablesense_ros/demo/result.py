"""What a headless demo found: each push, true against estimated, and the record over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_ros.demo.script import ScriptedPush
from cablesense_ros.page.score import angle_error_deg
from cablesense_ros.page.snapshot import Contact, Snapshot

SETTLING_S = 1.0
"""The first second of a push does not count: the arm swings and the estimate follows."""


@dataclass(frozen=True)
class PushResult:
    """One push and the estimate of it, the median over its steady part.

    Attributes:
        push: as scripted.
        estimate: None when nothing was reported for most of it.
        sample_count: steady moments looked at; 0 when no estimates came.
    """

    push: ScriptedPush
    estimate: Contact | None
    sample_count: int

    @property
    def segment_right(self) -> bool:
        """Whether the push was found on the segment where it was."""
        return self.estimate is not None and self.estimate.segment == self.push.segment

    @property
    def angle_error_deg(self) -> float | None:
        """Error of the direction, where the segment is right."""
        if self.estimate is None or not self.segment_right:
            return None
        return angle_error_deg(self.estimate.angle_deg, self.push.angle_deg)

    @property
    def magnitude_error_n(self) -> float | None:
        """Estimated minus true force, where the segment is right."""
        if self.estimate is None or not self.segment_right:
            return None
        return self.estimate.magnitude_n - self.push.magnitude_n


@dataclass(frozen=True)
class Record:
    """A headless demo from start to end: snapshots, and their times since the start."""

    times_s: NDArray[np.float64]
    snapshots: Sequence[Snapshot]
    heard: NDArray[np.bool_]
    """Whether an estimate was there at each moment, be it of no contact."""


def push_results(script: Sequence[ScriptedPush], record: Record) -> list[PushResult]:
    """The result of every push."""
    results = []
    for push in script:
        steady = (record.times_s >= push.start_s + SETTLING_S) & (
            record.times_s < push.end_s - 0.1
        )
        at = np.flatnonzero(steady & record.heard).tolist()
        contacts = [record.snapshots[i].estimate for i in at]
        results.append(PushResult(push, _median(contacts), len(at)))
    return results


def _median(contacts: Sequence[Contact | None]) -> Contact | None:
    segments = [contact.segment if contact else 0 for contact in contacts]
    if not segments:
        return None
    usual = max(set(segments), key=segments.count)
    same = [contact for contact in contacts if contact is not None and contact.segment == usual]
    if usual == 0:
        return None
    angles = np.deg2rad([contact.angle_deg for contact in same])
    angle = np.rad2deg(np.arctan2(np.median(np.sin(angles)), np.median(np.cos(angles)))) % 360.0
    force = np.median([contact.force_base_n for contact in same], axis=0)
    return Contact(usual, float(angle), float(np.median([c.magnitude_n for c in same])), force)


def summary(results: Sequence[PushResult]) -> dict[str, Any]:
    """Mean errors over all pushes; None where none was found on its segment."""
    angles = [r.angle_error_deg for r in results if r.angle_error_deg is not None]
    forces = [abs(r.magnitude_error_n) for r in results if r.magnitude_error_n is not None]
    return {
        "pushes": len(results),
        "estimated": sum(1 for r in results if r.sample_count),
        "segment_right": sum(1 for r in results if r.segment_right),
        "direction_mae_deg": float(np.mean(angles)) if angles else None,
        "magnitude_mae_n": float(np.mean(forces)) if forces else None,
    }


def as_json(results: Sequence[PushResult]) -> dict[str, Any]:
    """Everything that the table shows, for machines."""
    return {
        "summary": summary(results),
        "pushes": [
            {
                "true": {
                    "segment": r.push.segment,
                    "angle_deg": r.push.angle_deg,
                    "magnitude_n": r.push.magnitude_n,
                },
                "estimated": None
                if r.estimate is None
                else {
                    "segment": r.estimate.segment,
                    "angle_deg": r.estimate.angle_deg,
                    "magnitude_n": r.estimate.magnitude_n,
                },
                "samples": r.sample_count,
            }
            for r in results
        ],
    }
