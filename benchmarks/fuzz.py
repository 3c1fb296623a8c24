"""Random and edited frames, messages and files into every reader: no crash, no false force.

    python benchmarks/fuzz.py [--share 1.0] [--only frames models] [--seed 0] [--write]

More than 1,000,000 CAN frames, 100,000 messages to the estimator and 10,000 files. `hypothesis`
draws them, in child processes that are watched, and makes a failing one small. A finding is
a child that ends (a crash of native code, or an example beyond its time) or memory beyond a limit.
So is an error outside CableSense's family, a refusal of more than one line, or an answer that the
target's oracle calls false. Each child ends at its first finding; its last file is kept.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import harness
import hypothesis
import pandas as pd
from fuzz_edits import Check, Tally
from fuzz_files import FILE_TARGETS
from fuzz_live import LIVE_TARGETS
from hypothesis import strategies as st

EXAMPLE_LIMIT_S = 60.0
"""Longest time of an example, of which the slowest takes some seconds on a busy machine."""
GROWTH_LIMIT_MB = 1_500.0
"""The most address space that a child may add to that at its start."""
EXAMPLES_OF_A_CHILD = 2_000
CRASH = "crash.txt"
COUNTS = ("examples", *Tally._fields)
TARGETS = LIVE_TARGETS | FILE_TARGETS
"""All readers of what comes from outside, by name."""


def main() -> int:
    """Fuzz, print, and write; 1 where anything was found."""
    parser = harness.parser(__doc__, "results/fuzz.json")
    parser.add_argument("--share", type=float, default=1.0, help="of the examples")
    parser.add_argument("--only", nargs="+", choices=TARGETS, default=TARGETS, help="targets")
    parser.add_argument("--seed", type=int, default=0, help="other seeds make other examples")
    options = parser.parse_args()
    began_s = time.monotonic()
    work = []
    for name in options.only:
        examples = max(1, round(options.share * TARGETS[name].examples))
        for child, first in enumerate(range(0, examples, EXAMPLES_OF_A_CHILD)):
            count = min(EXAMPLES_OF_A_CHILD, examples - first)
            work.append((name, 1_000 * options.seed + child, count))
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        rows = list(threads.map(lambda one: watched(TARGETS[one[0]].check, *one), work))
    counts = pd.DataFrame(rows).groupby("target", sort=False)[list(COUNTS)].sum()
    units = [TARGETS[name].unit for name in counts.index]
    findings = [row["finding"] for row in rows if row["finding"]]
    report = {
        "seed": options.seed,
        "run_s": round(time.monotonic() - began_s, 1),
        "in all": counts["inputs"].groupby(units).sum().to_dict(),
        "targets": counts.to_dict(orient="index"),
        "findings": findings,
        "bars": {"nothing is found": not findings},
    }
    libraries = ("hypothesis", "onnx", "onnxruntime", "cantools", "PyYAML", "pydantic")
    return harness.publish("fuzz.json", report, options, *libraries)


def watched(check: Check, name: str, seed: int, count: int) -> dict[str, Any]:
    """Check examples in a child process: counts, and its finding or nothing."""
    folder = Path(tempfile.mkdtemp(prefix=f"fuzz_{name}_"))
    (folder / CRASH).touch()
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as child:
        try:
            counts, finding = child.submit(run_examples, check, seed, count, folder).result()
        except BrokenProcessPool:
            crash = (folder / CRASH).read_text(encoding="utf-8")
            counts = Counter()
            finding = f"its process ended: {_line(crash.splitlines()[:12])}"
    if finding:
        finding = f"{name}, seed {seed}, last file in {folder}: {finding}"[:2_000]
    else:
        shutil.rmtree(folder)
    return {"target": name, **dict.fromkeys(COUNTS, 0), **counts, "finding": finding}


def run_examples(check: Check, seed: int, count: int, folder: Path) -> tuple[Counter[str], str]:
    """Check examples in this process, with their files in a folder: counts, and the finding."""
    os.chdir(folder)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + int(GROWTH_LIMIT_MB * 1e6)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    counts: Counter[str] = Counter()

    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=count,
        deadline=None,
        database=None,
        report_multiple_bugs=False,
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    @hypothesis.given(st.data())
    def each(data: st.DataObject) -> None:
        faulthandler.dump_traceback_later(EXAMPLE_LIMIT_S, exit=True, file=crash)
        counts.update(examples=1, **check(data.draw)._asdict())
        faulthandler.cancel_dump_traceback_later()

    with Path(CRASH).open("w", encoding="utf-8") as crash:
        faulthandler.enable(crash)
        try:
            each()
        except BaseException:  # whatever escapes is a finding, also an exit
            return counts, _line(traceback.format_exc().splitlines()[-12:])
        finally:
            faulthandler.disable()
    return counts, ""


def _line(lines: Sequence[str]) -> str:
    return " | ".join(line.strip() for line in lines)


if __name__ == "__main__":
    sys.exit(main())
