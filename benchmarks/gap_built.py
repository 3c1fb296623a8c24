"""The diagnosis of arms as a workshop builds them, with nothing, one effect or several hidden.

    python benchmarks/gap_built.py [--count 8] [--seed 9511] [--effects 3-5] [--kinds A,B]
        [--write]

Each arm of the independent plant (`cablesense_plants.arm.built`) has errors of its own, of the
standard deviations that the arm file states, times `--scale`. Half of the arms hide nothing. The
others hide one listed effect, whose gap is 3 to 10 times the one that the arm's own errors make.
With `--effects` all hide so many; with `--kinds` those that are named, in turn. Friction and creep
are not among them by default, as they take minutes each.
"""

from __future__ import annotations

import os
import time
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import blind_sets
import harness
import numpy as np
from blind_sets import in_pool, removed_on
from rich.progress import track

from cablesense_gap.arm_system import diagnose
from cablesense_gap.scoring import read_answers
from cablesense_gap.verdict import Verdict
from cablesense_plants.arm.blind_cases import record_cases
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.built import Workmanship
from cablesense_plants.arm.listed import LISTED
from cablesense_plants.cases import NONE, in_turn
from cablesense_recording.reading import read_recording
from cablesense_sim.arm import find_arm, open_arm

os.environ.setdefault("OMP_NUM_THREADS", "1")

ARM = "cdsm_lab"
_SLOW = ("cable_creep", "capstan_friction", "joint_friction")


def main() -> None:
    """Draws, diagnoses, scores and prints; keeps the scores with `--write`."""
    parser = blind_sets.parser(__doc__, "gap_built.json, …_several.json, …_kinds.json", seed=9511)
    parser.set_defaults(count=8)
    parser.add_argument("--scale", type=float, default=1.0, help="of the workshop's errors")
    parser.add_argument("--kinds", default="", help="hidden effects, joined by commas")
    parser.add_argument(
        "--effects", type=blind_sets.effect_counts, help="in each case, as 3-5, not none or one"
    )
    parser.add_argument("--workers", type=int, default=1, help="processes")
    options = parser.parse_args()
    folder = blind_sets.folder_of(options)
    answers_file = folder / "answers" / "answers.csv"
    if not answers_file.exists():
        kinds = options.kinds.split(",") if options.kinds else _kinds(options)
        workmanship = Workmanship().scaled(options.scale)
        nominal = read_nominal(find_arm(ARM))
        made = record_cases(
            folder,
            answers_file,
            nominal,
            len(kinds),
            options.seed,
            kinds,
            options.workers,
            second=True,
            workmanship=workmanship,
        )
        list(track(made, "Recording", total=len(kinds)))
    answers = read_answers(answers_file)
    paths = [folder / f"{answer.recording}.csv" for answer in answers]
    work = partial(_finished, until_s=time.time() + 60.0 * options.minutes)
    outcomes = in_pool(work, paths, options.workers)
    done = {path.stem: outcome for path, outcome in zip(paths, outcomes, strict=True) if outcome}
    result = {"arm": ARM, "seed": options.seed, "scale": options.scale}
    harness.publish(_file_name(options), {**result, **blind_sets.scored(answers, done)}, options)


def _file_name(options: Any) -> str:
    if options.kinds:
        return "gap_built_kinds.json"
    if options.effects is None:
        return "gap_built.json"
    return "gap_built_pairs.json" if options.effects.most == 2 else "gap_built_several.json"


def _kinds(options: Any) -> list[str]:
    """Nothing and one effect in turn, none of which comes twice before all have come once.

    With `--effects`, so many different ones in each case.
    """
    rng = np.random.default_rng([options.seed])
    quick = [name for name in LISTED if name not in _SLOW]
    if options.effects:
        wanted = options.effects
        counts = rng.integers(wanted.least, wanted.most + 1, options.count)
        return ["+".join(sorted(rng.choice(quick, size, replace=False))) for size in counts]
    effects = list(islice(in_turn(rng, quick), options.count // 2))
    return [effects[k // 2] if k % 2 else NONE for k in range(options.count)]


def _finished(path: Path, until_s: float) -> blind_sets.Finished | None:
    return blind_sets.finished(path.with_name(f"{path.stem}."), until_s, partial(_diagnosed, path))


def _diagnosed(path: Path) -> tuple[Verdict, float]:
    """The verdict, and the share of the gap that the amended arm removes on another recording."""
    arm = open_arm(ARM)
    diagnosis = diagnose(read_recording(path, arm), arm)
    again = read_recording(path.parent / "second" / path.name, arm)
    floor_n = diagnosis.verdict.gap.floor_n
    return diagnosis.verdict, removed_on(again, arm, diagnosis.amended, floor_n)


if __name__ == "__main__":
    main()
