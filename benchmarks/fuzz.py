"""Random and edited frames, messages and files into every reader: no crash, no false force.

    python benchmarks/fuzz.py [--share 1.0] [--only frames,models] [--seed 0] [--write]

More than 1,000,000 CAN frames, 100,000 messages to the estimator and 10,000 files. `hypothesis`
draws them, in child processes that are watched, and makes a failing one small. Findings are: a
child that ends (a crash of native code, or an example beyond its time), memory beyond a limit, an
error outside CableSense's family, a refusal of more than one line, and an answer that the target's
oracle calls false. Each child ends at its first finding; its last file is kept.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import harness
import hypothesis
from fuzz_edits import Outcome, Target
from hypothesis import strategies as st

EXAMPLE_LIMIT_S = 60.0
"""Longest time of an example, of which the slowest takes some seconds on a busy machine."""
GROWTH_LIMIT_MB = 1_500.0
"""The most address space that a child may add to that at its start."""
EXAMPLES_OF_A_CHILD = 2_000
DONE = "done.json"
AIMS = {"CAN frames": 1_000_000, "messages": 100_000, "files": 10_000}


def targets() -> dict[str, Target]:
    """All readers of what comes from outside, by name."""
    from fuzz_files import FILE_TARGETS  # slow to import, and not needed for --help
    from fuzz_live import check_frames, check_messages

    return {
        "frames": Target("CAN frames", check_frames, 8_000),
        "messages": Target("messages", check_messages, 10_500),
        **FILE_TARGETS,
    }


def main() -> int:
    """Fuzz, print, and write; 1 where anything was found."""
    parser = harness.parser(__doc__, "results/fuzz.json")
    parser.add_argument("--share", type=float, default=1.0, help="of the examples")
    parser.add_argument("--only", default="", help="names of targets with commas between")
    parser.add_argument("--seed", type=int, default=0, help="other seeds make other examples")
    parser.add_argument("--workers", type=int, default=2, help="child processes at a time")
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    known = targets()
    if options.child:
        name, count, folder = options.child
        os.chdir(folder)
        run_examples(known[name], options.seed, int(count))
        return 0
    names = [name for name in options.only.split(",") if name] or list(known)
    if unknown := set(names) - set(known):
        parser.error(f"no target {', '.join(sorted(unknown))}")
    if options.write and (options.share < 1.0 or options.only):
        parser.error("only a full run is written")
    started_s, found = time.monotonic(), {}
    with ThreadPoolExecutor(options.workers) as workers:
        for name in names:
            count = max(1, round(options.share * known[name].examples))
            counts = [min(EXAMPLES_OF_A_CHILD, count - n)
                      for n in range(0, count, EXAMPLES_OF_A_CHILD)]  # fmt: skip
            seeds = [1_000 * options.seed + child for child in range(len(counts))]
            work = partial(watch, [sys.executable, str(Path(__file__).resolve())], name)
            found[name] = workers.map(work, seeds, counts)
        results = {name: _added(known[name], children) for name, children in found.items()}
    total: Counter[str] = Counter(dict.fromkeys(AIMS, 0))
    for one in results.values():
        total[one["unit"]] += one["inputs"]
    findings = sum(len(one["findings"]) for one in results.values())
    report = {
        "seed": options.seed,
        "run_s": round(time.monotonic() - started_s, 1),
        "aims": AIMS,
        "in all": {**total, "findings": findings},
        "targets": results,
    }
    libraries = ("hypothesis", "onnx", "onnxruntime", "cantools", "PyYAML", "pydantic")
    harness.publish("fuzz.json", report, options, *libraries)
    return 1 if findings else 0


def _added(target: Target, children: Any) -> dict[str, Any]:
    done = list(children)
    counts = {what: sum(one[what] for one in done) for what in ("examples", *Outcome._fields)}
    return {
        "unit": target.unit,
        **counts,
        "findings": [one["finding"] for one in done if one["finding"]],
    }


def watch(command: Sequence[str], name: str, seed: int, count: int) -> dict[str, Any]:
    """Run examples in a child process that `command` starts; gives counts, and its finding."""
    folder = tempfile.mkdtemp(prefix=f"fuzz_{name}_")
    given = [*command, f"--seed={seed}", "--child", name, str(count), folder]
    child = subprocess.run(given, capture_output=True, text=True, check=False)
    if child.returncode == 0 and Path(folder, DONE).exists():
        done: dict[str, Any] = json.loads(Path(folder, DONE).read_text(encoding="utf-8"))
    else:
        done = dict.fromkeys(("examples", *Outcome._fields), 0)
        done["finding"] = f"its process ended with {child.returncode}: {_end(child.stderr)}"
    if done["finding"]:
        done["finding"] = f"{name}, seed {seed}, last file in {folder}: {done['finding']}"[:2_000]
    else:
        shutil.rmtree(folder)
    return done


def _end(text: str) -> str:
    return " | ".join(text.strip().splitlines()[-12:])


def run_examples(target: Target, seed: int, count: int) -> None:
    """Check examples in this process; counts and the finding are in `DONE` of this folder."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + int(GROWTH_LIMIT_MB * 1e6)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    faulthandler.enable()
    done: Counter[str] = Counter()

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
        faulthandler.dump_traceback_later(EXAMPLE_LIMIT_S, exit=True)
        done.update(examples=1, **target.check(data.draw)._asdict())
        faulthandler.cancel_dump_traceback_later()

    finding = ""
    try:
        each()
    except BaseException:  # whatever escapes is a finding, also an exit
        finding = _end(traceback.format_exc())
    counts = {what: done[what] for what in ("examples", *Outcome._fields)}
    Path(DONE).write_text(json.dumps({**counts, "finding": finding}), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
