"""The diagnosis on recordings whose effects are withheld, made by the independent plant.

    python benchmarks/gap_blind.py [--count 60] [--friction 16] [--seed 9101] [--write]

Draws the recordings, diagnoses each without its answer, and scores the verdicts: those of all
kinds in turn, and apart from them those with friction of cables, of which more can be drawn. Seeds
below 9100 were used while the diagnosis was made; these were not. There are as many processes as
workers, each with one case; the time of a single diagnosis is in `gap_speed.py`. With `--folder`
it goes on where it was stopped, and begins with friction.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import harness
import numpy as np
from rich.progress import track

from cablesense_base.workers import WorkerPool
from cablesense_gap.pipeline import diagnose
from cablesense_gap.plant.body import read_nominal
from cablesense_gap.plant.withhold import Answer, draw_kinds, withhold
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.scoring import as_json, read_answers, score
from cablesense_gap.verdict import Verdict, read_verdict, write_verdict
from cablesense_sim.arm import find_arm, open_arm

os.environ.setdefault("OMP_NUM_THREADS", "1")

ARM = "cdsm_lab"
_FRICTION = ["capstan_friction"] * 3 + ["cable_creep+capstan_friction"]


def main() -> None:
    """Draws, diagnoses, scores and prints; keeps answers, verdicts and scores with `--write`."""
    parser = harness.parser(__doc__, "gap_blind/")
    parser.add_argument("--count", type=int, default=60, help="cases")
    parser.add_argument("--friction", type=int, default=0, help="cases more with friction")
    parser.add_argument("--seed", type=int, default=9101, help="of the plant")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--folder", type=Path, help="of recordings and verdicts, goes on there")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="gap_blind_"))
    answers = folder / "answers" / "answers.csv"
    if not answers.exists():
        kinds = draw_kinds(np.random.default_rng([options.seed]), options.count)
        kinds += [_FRICTION[i % len(_FRICTION)] for i in range(options.friction)]
        drawn(folder, len(kinds), options.seed, kinds, options.workers)
    began = time.monotonic()
    truth = read_answers(answers)
    recordings = [folder / f"{answer.recording}.csv" for answer in reversed(truth)]
    found = in_pool(_verdict, recordings, options.workers)
    verdicts = {path.stem: verdict for path, verdict in zip(recordings, found, strict=True)}
    rough = [answer for answer in truth if "capstan_friction" in answer.effects]
    result = {
        **harness.origin(),
        "arm": ARM,
        "seed": options.seed,
        "minutes": round((time.monotonic() - began) / 60.0, 1),
        **as_json(score(verdicts, truth[: options.count])),
        **({"friction": as_json(score(verdicts, rough))} if rough else {}),
    }
    print(json.dumps(result, indent=1))
    if options.write:
        lines = [v.model_dump_json(exclude_none=True) for _, v in sorted(verdicts.items())]
        harness.write_result("../gap_blind/score.json", result)
        harness.write_result("../gap_blind/answers.csv", answers.read_text())
        harness.write_result("../gap_blind/verdicts.jsonl", "\n".join(lines) + "\n")


def drawn(
    folder: Path, count: int, seed: int, only: Sequence[str] = (), workers: int = 1
) -> dict[str, Answer]:
    """Recordings `case_….csv` by the independent plant, and what is hidden in each by its name.

    The answers stand in `answers/answers.csv` beside them.
    """
    nominal, answers = read_nominal(find_arm(ARM)), folder / "answers" / "answers.csv"
    made = withhold(folder, answers, nominal, count, seed, tuple(only), workers)
    return {each.recording: each for each in track(made, description="Recording", total=count)}


def in_pool(work: Callable[[Path], Any], paths: Sequence[Path], workers: int) -> list[Any]:
    """What `work` makes of each path, in as many processes as workers."""
    with WorkerPool(workers) as pool:
        return list(track(pool.map(work, paths), "Working", total=len(paths)))


def _verdict(path: Path) -> Verdict:
    kept = path.with_name(f"{path.stem}.verdict.json")
    if not kept.exists():
        arm = open_arm(ARM)
        write_verdict(kept, diagnose(read_recording(path, arm), arm).verdict)
    return read_verdict(kept)


if __name__ == "__main__":
    main()
