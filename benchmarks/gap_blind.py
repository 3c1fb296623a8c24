"""The diagnosis on recordings whose effects are withheld, made by the independent plant.

    python benchmarks/gap_blind.py [--count 60] [--friction 16] [--seed 9101] [--write]
    python benchmarks/gap_blind.py --effects 3-5 --count 40 --seed 9304 [--minutes 8] [--write]

Draws the recordings, diagnoses each without its answer, and scores the verdicts: those of all
kinds in turn, and apart from them those with friction of cables, of which more can be drawn; or
arms with several effects at once, whose budgets are scored too. Every arm is recorded twice: the
amended arm of the first recording predicts the second. Seeds below 9100 were used while the
diagnosis was made; these were not. There are as many processes as workers, each with one case;
the time of a single diagnosis is in `gap_speed.py`. With `--folder` it goes on where it was
stopped, and begins with friction; after `--minutes` it begins no further case, and scores those
that are done.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import harness
import numpy as np
from rich.progress import track

from cablesense_base.workers import WorkerPool
from cablesense_gap.pipeline import diagnose
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.scoring import Answer as Case
from cablesense_gap.scoring import as_json, read_answers, score
from cablesense_gap.settling import removed_on
from cablesense_gap.verdict import (
    NONE,
    UNKNOWN,
    Verdict,
    read_verdict,
    write_verdict,
)
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.withhold import Answer, draw_kinds, draw_several, withhold
from cablesense_sim.arm import find_arm, open_arm

os.environ.setdefault("OMP_NUM_THREADS", "1")

ARM = "cdsm_lab"
SETTLED_ROWS = 60
"""Of a second recording, from which history-dependent states are estimated."""
_FRICTION = ["capstan_friction"] * 3 + ["cable_creep+capstan_friction"]


def main() -> None:
    """Draws, diagnoses, scores and prints; keeps answers, verdicts and scores with `--write`."""
    parser = harness.parser(__doc__, "gap_blind/, gap_blind_friction/ or gap_blind_several/")
    parser.add_argument("--count", type=int, default=60, help="cases")
    parser.add_argument("--friction", type=int, default=0, help="cases more with friction")
    parser.add_argument("--seed", type=int, default=9101, help="of the plant")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--effects", help="how many in each case, from-to, instead of all kinds")
    parser.add_argument("--minutes", type=float, default=np.inf, help="then no further case")
    parser.add_argument("--folder", type=Path, help="of recordings and verdicts, goes on there")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="gap_blind_"))
    answers, began = folder / "answers" / "answers.csv", time.time()
    if not answers.exists():
        rng = np.random.default_rng([options.seed])
        if options.effects:
            least, most = map(int, options.effects.split("-"))
            kinds = draw_several(rng, options.count, least, most)
        else:
            kinds = draw_kinds(rng, options.count)
        kinds += [_FRICTION[i % len(_FRICTION)] for i in range(options.friction)]
        drawn(folder, len(kinds), options.seed, kinds, options.workers, second=True)
    everything = read_answers(answers)
    recordings = [folder / f"{answer.recording}.csv" for answer in reversed(everything)]
    work = partial(_diagnosed, until=began + 60.0 * options.minutes)
    found = in_pool(work, recordings, options.workers)
    done = {path.stem: each for path, each in zip(recordings, found, strict=True) if each}
    verdicts = {name: verdict for name, (verdict, _) in done.items()}
    truth = [answer for answer in everything if answer.recording in done]
    if not truth:
        print(f"no case was done in time; go on with --folder {folder}")
        return
    rough = [answer for answer in truth if "capstan_friction" in answer.effects]
    seconds = [verdict.seconds for verdict in verdicts.values()]
    result = {
        **harness.origin(),
        "arm": ARM,
        "seed": options.seed,
        "seconds_of_a_diagnosis": {
            "median": round(np.median(seconds)),
            "most": round(max(seconds)),
        },
        **as_json(score(verdicts, [a for a in truth if a in everything[: options.count]])),
        "second_recording": _second({a.recording: done[a.recording][1] for a in truth}, truth),
        **({"friction": as_json(score(verdicts, rough))} if rough else {}),
    }
    print(json.dumps(result, indent=1))
    if options.write:
        lines = [v.model_dump_json(exclude_none=True) for _, v in sorted(verdicts.items())]
        kind = "_several" if options.effects else "_friction" if options.friction else ""
        harness.write_result(f"../gap_blind{kind}/score.json", result)
        harness.write_result(f"../gap_blind{kind}/answers.csv", answers.read_text())
        harness.write_result(f"../gap_blind{kind}/verdicts.jsonl", "\n".join(lines) + "\n")


def drawn(
    folder: Path,
    count: int,
    seed: int,
    only: Sequence[str] = (),
    workers: int = 1,
    *,
    second: bool = False,
) -> dict[str, Answer]:
    """Recordings `case_….csv` by the independent plant, and what is hidden in each by its name.

    The answers stand in `answers/answers.csv` beside them.
    """
    nominal, answers = read_nominal(find_arm(ARM)), folder / "answers" / "answers.csv"
    made = withhold(folder, answers, nominal, count, seed, tuple(only), workers, second=second)
    return {each.recording: each for each in track(made, description="Recording", total=count)}


def in_pool(work: Callable[[Path], Any], paths: Sequence[Path], workers: int) -> list[Any]:
    """What `work` makes of each path, in as many processes as workers."""
    with WorkerPool(workers) as pool:
        return list(track(pool.map(work, paths), "Working", total=len(paths)))


def _diagnosed(path: Path, until: float) -> tuple[Verdict, float] | None:
    """The verdict, and the share of the gap that its arm removes on the second recording.

    None where the time for new cases is over.
    """
    kept, beside = (path.with_name(f"{path.stem}.{what}.json") for what in ("verdict", "second"))
    if not beside.exists():
        if time.time() > until:
            return None
        arm = open_arm(ARM)
        diagnosis = diagnose(read_recording(path, arm), arm)
        write_verdict(kept, diagnosis.verdict)
        again = read_recording(path.parent / "second" / path.name, arm)
        floor_n = diagnosis.verdict.gap.floor_n
        removed = removed_on(again, arm, diagnosis.amended, SETTLED_ROWS, floor_n)
        beside.write_text(json.dumps(removed))
    return read_verdict(kept), json.loads(beside.read_text())


def _second(removed: dict[str, float], truth: Sequence[Case]) -> dict[str, object]:
    """Share of the gap removed on second recordings of arms with effects of the library."""
    listed = [removed[a.recording] for a in truth if a.effects[0] not in (NONE, UNKNOWN)]
    median = float(np.median(listed)) if listed else None
    return {"median_removed_fraction": median, "removed_fractions": removed}


if __name__ == "__main__":
    main()
