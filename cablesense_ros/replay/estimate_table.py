"""Estimates as CSV: one row a sample."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from cablesense_gap.recordings.recording_error import RecordingError
from cablesense_ros.outcome import Outcome


class EstimateTable:
    """Writes rows; numbers with all their digits."""

    def __init__(self, file: TextIO) -> None:
        self._rows = csv.writer(file, lineterminator="\n")
        self._begun = False

    def add(self, stamp_ns: int, outcome: Outcome, segment_count: int) -> None:
        """The answer to one sample of an arm with N segments.

        `segment` is 0 without a contact; probabilities are empty where nothing was estimated: in a
        move, before the first tare, at a sample of no use, whose `problem` is said then.
        """
        if not self._begun:
            self._begun = True
            beliefs = ["p_none", *(f"p_segment_{n + 1}" for n in range(segment_count))]
            self._rows.writerow(
                ["stamp_ns", "segment", "angle_deg", "magnitude_n", *beliefs, "problem"]
            )
        contact = outcome.contact
        beliefs = [*outcome.probabilities] or [""] * (segment_count + 1)  # type: ignore[list-item]
        problem = "" if outcome.problem is None else outcome.problem.kind.value
        touched = [contact.angle_deg, contact.magnitude_n] if contact.segment else ["", ""]
        self._rows.writerow([stamp_ns, contact.segment, *touched, *beliefs, problem])


@contextmanager
def estimate_table(path: Path) -> Iterator[EstimateTable]:
    """A table that stands under its name when it is whole.

    Raises:
        RecordingError: it cannot be written there.
    """
    beside = path.with_name(f".{path.name}.part")
    try:
        with beside.open("w", encoding="utf-8", newline="") as file:
            yield EstimateTable(file)
        beside.replace(path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        beside.unlink(missing_ok=True)
