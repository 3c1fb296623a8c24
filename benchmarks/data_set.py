"""A small data set with answers, so that other methods can be compared with the diagnosis.

    python benchmarks/data_set.py --out FOLDER [--count 8] [--seed 6120] [--workers 2]
    python benchmarks/data_set.py --out FOLDER --baseline [--write]

The first command makes recordings, answers and the card; the second diagnoses the recordings that
are there, scores the verdicts, and keeps the scores, which the card then states. Recordings with
friction have no baseline unless `--groups` names them: each takes minutes.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from string import Template
from typing import Any, Final

import blind_sets
import harness
import numpy as np
from rich.progress import track

from cablesense_base import CableSenseError
from cablesense_base.files import output_folder, write_atomically
from cablesense_base.installation import package_version
from cablesense_gap.amended_arm import write_arm
from cablesense_gap.arm_system import diagnose
from cablesense_gap.scoring import read_answers, score
from cablesense_gap.verdict import Verdict, read_verdict, write_verdict
from cablesense_plants.arm.blind_cases import record_cases
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.built import Workmanship
from cablesense_plants.arm.listed import LISTED
from cablesense_plants.cases import NONE, UNKNOWN, different, in_turn
from cablesense_recording.reading import read_recording
from cablesense_sim.arm import find_arm, load_arm, open_arm

os.environ.setdefault("OMP_NUM_THREADS", "1")

ARM: Final = "cdsm_lab"
FRICTION: Final = ("cable_creep", "capstan_friction", "joint_friction")
"""What the group `friction` hides, one each; the others hide none of it."""
MEASURED: Final = ("nominal", "built")
"""Groups that are diagnosed for the baseline unless others are named."""
ARM_FILE: Final = "arm.yaml"
RESULT: Final = "data_set.json"
_BASELINE = "python benchmarks/data_set.py --out FOLDER --baseline --write"
_CARD = Path(__file__).with_name("data_set_card.md")


def main() -> None:
    """Makes the data set, or diagnoses it."""
    parser = harness.parser(__doc__, f"results/{RESULT}")
    parser.add_argument("--out", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--count", type=int, default=8, help="recordings of each group")
    parser.add_argument("--seed", type=int, default=6120, help="of the plant")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--baseline", action="store_true", help="diagnose and score what is there")
    parser.add_argument("--groups", default=",".join(MEASURED), help="to diagnose, by commas")
    options = parser.parse_args()
    if options.baseline:
        groups = options.groups.split(",")
        scores = {group: baseline(options.out, group, options.workers) for group in groups}
        origin = {"arm": ARM, "seed": options.seed, "count": options.count}
        harness.publish(RESULT, {**origin, "groups": scores}, options)
        write_card(options.out, options.seed)
    else:
        make(options)
        print(f"{options.out / 'README.md'} says what it is")


def make(options: argparse.Namespace) -> None:
    """Write recordings, answers, arm files and the card into a new folder.

    Raises:
        OutputError: a data set is there already.
    """
    out: Path = options.out
    output_folder(out, ("README.md", "*/case_*.csv", "answers/*.csv"))
    for number, (group, kinds) in enumerate(kinds_of(options.count, options.seed).items()):
        workmanship = Workmanship() if group == "built" else None
        answers_file = out / "answers" / f"{group}.csv"
        nominal = read_nominal(find_arm(ARM))
        recorded_cases = record_cases(
            out / group,
            answers_file,
            nominal,
            len(kinds),
            options.seed + number,
            kinds,
            options.workers,
            workmanship=workmanship,
        )
        list(track(recorded_cases, f"Recording {group}", total=len(kinds)))
        known = open_arm(ARM) if group == "built" else blind_sets.narrow_arm(ARM)
        write_arm(out / group / ARM_FILE, known, "The nominal arm, with its maker's tolerances.")
    write_card(out, options.seed)


def kinds_of(count: int, seed: int) -> dict[str, list[str]]:
    """What the recordings of each group hide.

    A quarter hides nothing, a quarter something that no verdict has a name for, an eighth two
    effects, the rest one; no effect comes twice before all have come once.
    """
    kinds = {}
    for number, group in enumerate(MEASURED):
        rng = np.random.default_rng([seed, number])
        effects = in_turn(rng, [name for name in LISTED if name not in FRICTION])
        quarter = count // 4
        pairs = count // 8
        drawn = [NONE] * quarter + [UNKNOWN] * quarter
        drawn += ["+".join(sorted(different(effects, 2))) for _ in range(pairs)]
        drawn += [next(effects) for _ in range(count - len(drawn))]
        kinds[group] = [drawn[i] for i in rng.permutation(count)]
    return {**kinds, "friction": list(FRICTION)}


def baseline(folder: Path, group: str, workers: int) -> dict[str, Any]:
    """The scores of the diagnosis on a group, and each of its cases.

    Verdicts are kept in `verdicts/` of the data set; those that are there are not made again.
    """
    verdicts_folder = folder / "verdicts" / group
    verdicts_folder.mkdir(parents=True, exist_ok=True)
    answers = read_answers(folder / "answers" / f"{group}.csv")
    paths = [folder / group / f"{answer.recording}.csv" for answer in answers]
    judged = blind_sets.in_pool(partial(_verdict, verdicts_folder), paths, workers)
    verdicts = {path.stem: verdict for path, verdict in zip(paths, judged, strict=True)}
    cases = [blind_sets.case(answer, verdicts[answer.recording], None) for answer in answers]
    return {**asdict(score(verdicts, answers)), "each_case": cases}


def _verdict(verdicts_folder: Path, path: Path) -> Verdict:
    kept = verdicts_folder / f"{path.stem}.json"
    if not kept.exists():
        arm = load_arm(path.with_name(ARM_FILE))
        write_verdict(kept, diagnose(read_recording(path, arm), arm).verdict)
    return read_verdict(kept)


def write_card(out: Path, seed: int) -> None:
    """Write the card of the recordings that are there, with the baseline as committed."""
    counts = {
        group: len(read_answers(out / "answers" / f"{group}.csv"))
        for group in (*MEASURED, "friction")
    }
    write_atomically(out / "README.md", card(counts, seed, results()), CableSenseError)


def card(counts: Mapping[str, int], seed: int, scores: Mapping[str, Any]) -> str:
    """The text of the card, with the baseline if it was measured on this very set."""
    is_of_this = (scores.get("seed"), scores.get("count")) == (seed, counts["nominal"])
    groups = scores["groups"] if is_of_this else {}
    missing = [name for name in counts if name not in groups]
    return Template(_CARD.read_text(encoding="utf-8")).substitute(
        counts,
        count=counts["nominal"],
        seed=seed,
        version=package_version(),
        command=scores["command"] if is_of_this else _BASELINE,
        baseline="\n\n".join([*_table(groups), *_without_baseline(missing)]),
    )


def _table(groups: Mapping[str, Any]) -> list[str]:
    """The table of scores, a column for each group; none without a baseline."""
    if not groups:
        return []
    named = {
        "effects right": "exact",
        "places right, where the effect is": "where",
        "false alarms": "false_alarms",
        "unlisted causes called unknown": "unknown_recall",
    }
    rows = [["", *groups], ["---"] * (1 + len(groups))]
    for label, key in named.items():
        shares = [scores[key] for scores in groups.values()]
        rows.append([label, *(f"{share['hits']} of {share['count']}" for share in shares)])
    removed = [scores["median_removed_fraction"] or 0.0 for scores in groups.values()]
    rows.append(["gap removed, median of those right", *(f"{share:.0%}" for share in removed)])
    return ["\n".join(f"| {' | '.join(row)} |" for row in rows)]


def _without_baseline(groups: Sequence[str]) -> list[str]:
    return [f"No baseline was measured for {', '.join(groups)}."] if groups else []


def results() -> dict[str, Any]:
    """The committed scores; empty where there are none."""
    path = harness.RESULTS / RESULT
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return content


if __name__ == "__main__":
    main()
