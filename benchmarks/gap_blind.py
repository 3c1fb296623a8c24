"""The diagnosis on recordings whose effects are withheld, made by the independent plant.

    python benchmarks/gap_blind.py [--count 60] [--seed 9101] [--workers 2] [--write]

Draws the recordings, diagnoses each without its answer, and scores the verdicts. Seeds below 9100
were used while the diagnosis was made; this one was not. Cases are worked on in as many processes
as there are workers, each of them with one; what a single diagnosis takes is in `gap_speed.py`.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from rich.progress import track

from cablesense_gap.pipeline import diagnose
from cablesense_gap.plant.body import read_nominal
from cablesense_gap.plant.withhold import withhold
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.scoring import as_json, read_answers, score
from cablesense_gap.verdict import Verdict, read_verdict, write_verdict
from cablesense_sim.arm import find_arm, open_arm

os.environ.setdefault("OMP_NUM_THREADS", "1")


RESULTS = Path(__file__).parent / "gap_blind"
ARM = "cdsm_lab"


def main() -> None:
    """Draws, diagnoses, scores and prints; keeps answers, verdicts and scores with `--write`."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=60, help="cases")
    parser.add_argument("--seed", type=int, default=9101, help="of the plant")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--folder", type=Path, help="for recordings and verdicts; goes on there")
    parser.add_argument("--write", action="store_true", help=f"write {RESULTS.name}/")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="gap_blind_"))
    answers = folder / "answers" / "answers.csv"
    if not answers.exists():
        nominal = read_nominal(find_arm(ARM))
        made = withhold(
            folder, answers, nominal, options.count, options.seed, workers=options.workers
        )
        for _ in track(made, description="Recording", total=options.count):
            pass
    began = time.monotonic()
    verdicts = _verdicts(folder, options.workers)
    result = {
        "command": f"python benchmarks/gap_blind.py --count {options.count} --seed {options.seed}",
        "arm": ARM,
        "seed": options.seed,
        "minutes": round((time.monotonic() - began) / 60.0, 1),
        **as_json(score(verdicts, read_answers(answers))),
    }
    print(json.dumps(result, indent=1))
    if options.write:
        RESULTS.mkdir(exist_ok=True)
        (RESULTS / "score.json").write_text(json.dumps(result, indent=1) + "\n")
        (RESULTS / "answers.csv").write_text(answers.read_text())
        (RESULTS / "verdicts.jsonl").write_text(
            "".join(
                v.model_dump_json(exclude_none=True) + "\n" for _, v in sorted(verdicts.items())
            )
        )


def _verdicts(folder: Path, workers: int) -> dict[str, Verdict]:
    """Verdicts of all recordings of a folder; those that it has already are read."""
    recordings = sorted(folder.glob("case_*.csv"))
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        done = track(
            pool.map(_verdict, recordings), description="Diagnosing", total=len(recordings)
        )
        return {path.stem: verdict for path, verdict in zip(recordings, done, strict=False)}


def _verdict(path: Path) -> Verdict:
    kept = path.with_name(f"{path.stem}.verdict.json")
    if not kept.exists():
        arm = open_arm(ARM)
        write_verdict(kept, diagnose(read_recording(path, arm), arm).verdict)
    return read_verdict(kept)


if __name__ == "__main__":
    main()
