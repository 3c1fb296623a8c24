"""The fourteen recordings whose effects are withheld, diagnosed.

    python benchmarks/gap_withheld.py [--workers 2]

Writes `withheld/rec_NN/` with verdict, report and amended arm for each recording of
`withheld/recordings/`, and `withheld/README.md` with one line for each. Nothing is tuned to any
of them; their answers were not known when this was run.
"""

from __future__ import annotations

import argparse
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


def main() -> None:
    """Diagnoses what has no verdict yet, and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--workers", type=int, default=2, help="processes")
    options = parser.parse_args()
    recordings = sorted((FOLDER / "recordings").glob("*.csv"))
    done = in_pool(_verdict, recordings, options.workers)
    lines = [_line(path.stem, verdict) for path, verdict in zip(recordings, done, strict=True)]
    harness.write_result("../withheld/README.md", HEADING + "\n".join(lines) + "\n")


def _verdict(path: Path) -> Verdict:
    folder = FOLDER / path.stem
    if not (folder / "verdict.json").exists():
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


if __name__ == "__main__":
    main()
