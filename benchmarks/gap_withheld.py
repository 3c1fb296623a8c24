"""The recordings whose effects are withheld, diagnosed: fourteen, and eight of several effects.

    python benchmarks/gap_withheld.py [--workers 2]
    python benchmarks/gap_withheld.py --second FOLDER [--workers 2] [--minutes 8]

Writes `withheld/rec_NN/` with verdict, report and amended arm for each recording of
`withheld/recordings/`, and `withheld/README.md` with one line for each; with `--second` the same
in `withheld_second/` for the recordings of a folder. What has a verdict keeps it, and after
`--minutes` no further one is begun. Nothing is tuned to any of them; their answers were not known
when this was run.
"""

from __future__ import annotations

import argparse
import math
import time
from functools import partial
from pathlib import Path

import harness
from gap_blind import ARM, in_pool

from cablesense_gap.pipeline import diagnose
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.report.page import write_diagnosis
from cablesense_gap.verdict import Verdict, read_verdict
from cablesense_sim.arm import open_arm

FOLDER = Path(__file__).parent / "withheld"
HEADING = """# Fourteen recordings whose effects are withheld

Arms that are all `config/arms/cdsm_lab.yaml` except for what is hidden: nothing, one effect, two
at once, or one that is in nobody's list. They come from a plant that shares no code with this
project. The verdicts below were given before the answers were known, by

    python benchmarks/gap_withheld.py

Gaps are RMS over all cables, on trials that were not fitted; the sensors' floor is 0.072 N.

All fourteen were diagnosed by one and the same code. A first version had diagnosed them before;
what was changed since was found on simulated cases, except that rec_12, for which it had fitted
no single effect at all, was among the reasons to look at how candidates are ranked.

| recording | verdict | probability | where | gap before | after | parameters |
| --- | --- | --- | --- | --- | --- | --- |
"""
SECOND = """# Eight recordings of several effects at once, whose answers are withheld

Arms that are all `config/arms/cdsm_lab.yaml` except for two to five effects of the list. They come
from a plant that shares no code with this project. The verdicts were given before the answers were
known, by

    python benchmarks/gap_withheld.py --second FOLDER

All eight were diagnosed by one and the same code. Before that an earlier one had diagnosed rec_15
alone; that joint selection goes on beside a single effect which dominates and depends on history
was changed after it, for that result among other reasons. Nothing was fitted to these recordings.

Shares and gaps are RMS over all cables; gaps and what is unexplained are on trials that were not
fitted; the sensors' floor is 0.072 N.

| recording | shares | probability | gap before | gap after | unexplained |
| --- | --- | --- | --- | --- | --- |
"""


def main() -> None:
    """Diagnoses what has no verdict yet, and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--second", type=Path, help="folder of the eight recordings")
    parser.add_argument("--minutes", type=float, default=math.inf, help="then no further case")
    options = parser.parse_args()
    out = Path(f"{FOLDER}_second") if options.second else FOLDER
    recordings = sorted((options.second or FOLDER / "recordings").glob("*.csv"))
    work = partial(_verdict, out=out, until=time.time() + 60.0 * options.minutes)
    done = in_pool(work, recordings, options.workers)
    line = _budget if options.second else _line
    lines = [line(path.stem, v) for path, v in zip(recordings, done, strict=True) if v]
    heading = SECOND if options.second else HEADING
    harness.write_result(f"../{out.name}/README.md", heading + "\n".join(lines) + "\n")


def _verdict(path: Path, out: Path, until: float) -> Verdict | None:
    folder = out / path.stem
    if not (folder / "verdict.json").exists():
        if time.time() > until:
            return None
        arm = open_arm(ARM)
        write_diagnosis(folder, diagnose(read_recording(path, arm), arm))
    return read_verdict(folder / "verdict.json")


def _line(name: str, verdict: Verdict) -> str:
    numbers = [
        f"{key} = {estimate.value:.3g} {estimate.unit}"
        for key, estimate in verdict.parameters.items()
        if "start" not in key and "rise" not in key
    ]
    places = " ".join(sorted(verdict.where.places)) or "–"
    return (
        f"| [{name}]({name}/report.html) | {' + '.join(verdict.effects)} | "
        f"{verdict.probability:.2f} | {places} | {verdict.gap.before_n:.2f} N | "
        f"{verdict.gap.after_n:.2f} N | {'; '.join(numbers) or '–'} |"
    )


def _budget(name: str, verdict: Verdict) -> str:
    shares = [
        f"{effect} {share.share_n:.2f} N ({' '.join(share.places) or 'arm'})"
        for effect, share in verdict.shares.items()
    ]
    gap = verdict.gap
    return (
        f"| [{name}]({name}/report.html) | {'; '.join(shares) or ' + '.join(verdict.effects)} | "
        f"{verdict.probability:.2f} | {gap.before_n:.2f} N | {gap.after_n:.2f} N | "
        f"{verdict.unexplained_n or 0.0:.2f} N, {verdict.unexplained_share or 0.0:.0%} |"
    )


if __name__ == "__main__":
    main()
