"""Blind sets: recordings are diagnosed without their answers, and the verdicts are scored.

Every machine is recorded twice: the amended model of the first recording predicts the second.
Verdicts are kept next to the recordings, so that a set continues where it was stopped.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import harness
import numpy as np
from rich.progress import track

from cablesense_base.workers import WorkerPool
from cablesense_gap.arm_simulator import counted_rows, settled
from cablesense_gap.scoring import Truth, score
from cablesense_gap.verdict import (
    NONE,
    UNKNOWN,
    Verdict,
    read_verdict,
    removed_fraction,
    write_verdict,
)
from cablesense_recording.recording import Recording
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.replay import replay_arm
from cablesense_sim.tolerances import Tolerances

NARROW = (
    Tolerances()
    .scaled(0.0)
    .model_copy(
        update={
            "pretension_n": 0.15,
            "segment_mass_share": 0.005,
            "hole_around_m": 1e-4,
            "sensor_zero_n": 0.05,
            "contact_m": 3e-4,
            "friction_share": 0.1,
        }
    )
)
"""What plants with `with_tolerances` scatter by, as the arm that is diagnosed states it.

Their holes of one cable are turned by 0.05 degrees together, 44 um of five holes at 50 mm.
Independent holes of 0.1 mm have a mean as wide as that.
"""


SETTLED_ROWS = 60
"""The rows of a second recording from which history-dependent states are estimated."""


def narrow_arm(name: str) -> Arm:
    """A bundled arm that states `NARROW` tolerances."""
    return open_arm(name).model_copy(update={"tolerances": NARROW})


class Finished(NamedTuple):
    """A verdict, and the share of the gap that its model removes on the second recording."""

    verdict: Verdict
    second_removed: float


def parser(doc: str | None, writes: str, seed: int) -> argparse.ArgumentParser:
    """The options of a blind set."""
    made = harness.parser(doc, writes)
    made.add_argument("--count", type=int, default=60, help="cases")
    made.add_argument("--seed", type=int, default=seed, help="of the plant")
    made.add_argument("--minutes", type=float, default=np.inf, help="then no further case")
    made.add_argument("--folder", type=Path, help="of recordings and verdicts, continued there")
    return made


class EffectCounts(NamedTuple):
    """How many effects each case of a set hides."""

    least: int
    most: int


def effect_counts(text: str) -> EffectCounts:
    """Those of an option such as `3-5`.

    Raises:
        ValueError, TypeError: the text is no two whole numbers.
    """
    ends = [int(end) for end in text.split("-")]
    return EffectCounts(*ends)


def folder_of(options: argparse.Namespace) -> Path:
    """The folder of the set, a new one unless one is given."""
    chosen: Path | None = options.folder
    return chosen or Path(tempfile.mkdtemp(prefix="blind_"))


def in_pool(work: Callable[[Path], Any], paths: Sequence[Path], workers: int) -> list[Any]:
    """What `work` makes of each path, in as many processes as workers."""
    with WorkerPool(workers) as pool:
        return list(track(pool.map(work, paths), "Working", total=len(paths)))


def removed_on(recording: Recording, nominal: Arm, amended: Arm, floor_n: float) -> float:
    """The share of the removable gap that an amended arm removes on a new recording of it.

    Its state is estimated from the first rows, which do not count.
    """
    nominal_n, amended_n = (
        replay_arm(arm, recording.course)
        for arm in (nominal, settled(amended, recording, SETTLED_ROWS))
    )
    judged = counted_rows(nominal, recording, nominal_n)
    judged[:SETTLED_ROWS] = False
    before_n, after_n = (
        float(np.sqrt(((recording.tensions_n - replayed_n)[judged] ** 2).mean()))
        for replayed_n in (nominal_n, amended_n)
    )
    return removed_fraction(before_n, after_n, floor_n)


def finished(
    beside: Path, until_s: float, diagnosed: Callable[[], tuple[Verdict, float]]
) -> Finished | None:
    """A case that is kept in `<beside>verdict.json` and `<beside>second.json`, or done now.

    None where the time for new cases is over (`until_s`, of `time.time`).
    """
    verdict_file = beside.with_name(f"{beside.name}verdict.json")

    def make() -> float:
        verdict, removed = diagnosed()
        write_verdict(verdict_file, verdict)
        return removed

    removed = harness.kept(beside.with_name(f"{beside.name}second.json"), make, until_s)
    return None if removed is None else Finished(read_verdict(verdict_file), removed)


def scored(answers: Sequence[Truth], done: Mapping[str, Finished]) -> dict[str, Any]:
    """The score sheet of the finished cases, and each of them.

    Raises:
        SystemExit: no case is finished.
    """
    truth = [answer for answer in answers if answer.recording in done]
    if not truth:
        raise SystemExit("no case was done in time; go on with --folder")
    verdicts = {name: one.verdict for name, one in done.items()}
    seconds = [verdict.seconds or 0.0 for verdict in verdicts.values()]
    listed = [a for a in truth if a.effects[0] not in (NONE, UNKNOWN)]
    removed = [done[a.recording].second_removed for a in listed]
    return {
        "seconds_of_a_diagnosis": harness.percentiles(seconds, ("median", "worst"), 0),
        **asdict(score(verdicts, truth)),
        "second_recording": {"removed_fraction": harness.percentiles(removed, ("median",))},
        "each_case": [case(a, *done[a.recording]) for a in truth],
    }


def case(answer: Truth, verdict: Verdict, second_removed: float | None) -> dict[str, Any]:
    """The hidden and the named effects of a case, and how far the gap shrinks."""
    return {
        "case": answer.recording,
        "hidden": "+".join(answer.effects),
        "named": "+".join(verdict.effects),
        "probability": round(verdict.probability, 3),
        "places": " ".join(verdict.where.places),
        "before": round(verdict.gap.before_n, 3),
        "after": round(verdict.gap.after_n, 3),
        "second_removed": None if second_removed is None else round(second_removed, 4),
        "seconds": round(verdict.seconds or 0.0, 1),
    }
