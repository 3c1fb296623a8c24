"""Mutated frames, messages and files into every reader: no crash, no hang, no false force.

    python benchmarks/fuzz.py [--quick] [--only frames,models] [--seed 0] [--workers 2] [--write]

More than 1,000,000 CAN frames, 100,000 messages to the estimator and 10,000 files. Each target
runs in child processes. Findings are: a child that ends (a crash of native code, or an item
beyond its time), memory beyond a limit, an error outside CableSense's family, a refusal of more
than one line, and an answer that the target's oracle calls false. A finding names its item, which
`--seed` makes again.
"""

from __future__ import annotations

import argparse
import faulthandler
import itertools
import json
import os
import resource
import subprocess
import sys
import time
import traceback
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import harness
from fuzz_mutation import FalseAnswerError, Target

ITEM_LIMIT_S = 60.0
"""Longest time of an item, of which the slowest takes some seconds: a busy machine delays all."""
GROWTH_LIMIT_MB = 1_500.0
"""The most address space that a child may add to that at its start."""
FINDING_KINDS = ("ended", "escaped", "false_answers")
INPUTS = ("inputs", "refused", "taken")
SHARES = 3
"""Parts of a full target, which go to the workers."""
BARS = {"CAN frames": 1_000_000, "messages": 100_000, "files": 10_000}


def targets() -> dict[str, Target]:
    """All readers of what comes from outside, by name."""
    from fuzz_files import FILE_TARGETS  # slow to import, and not needed for --help
    from fuzz_frames import make_frames
    from fuzz_messages import make_messages

    return {
        "frames": Target("CAN frames", make_frames, 4_000, 12),
        "messages": Target("messages", make_messages, 1_050, 3),
        **FILE_TARGETS,
    }


def main() -> int:
    """Fuzz, print, and write; 1 where anything was found."""
    parser = harness.parser(__doc__, "results/fuzz.json")
    parser.add_argument("--quick", action="store_true", help="some seconds instead of minutes")
    parser.add_argument("--only", default="", help="names of targets with commas between")
    parser.add_argument("--seed", type=int, default=0, help="other seeds make other items")
    parser.add_argument("--workers", type=int, default=2, help="child processes at a time")
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    known = targets()
    if options.child:
        name, first, end = options.child
        run_items(known[name], options.seed, range(int(first), int(end)))
        return 0
    names = [name for name in options.only.split(",") if name] or list(known)
    if unknown := set(names) - set(known):
        parser.error(f"no target {', '.join(sorted(unknown))}")
    if options.write and (options.quick or options.only):
        parser.error("only a full run is written")
    started_s, results = time.monotonic(), dict[str, Any]()
    with ThreadPoolExecutor(options.workers) as workers:
        for name in names:
            count = known[name].quick_items if options.quick else known[name].items
            shares = 1 if options.quick else SHARES
            cuts = [count * i // shares for i in range(shares + 1)]
            results[name] = [
                workers.submit(watch, [sys.executable, __file__], name, options.seed, first, end)
                for first, end in itertools.pairwise(cuts)
            ]
        found = {name: _added(one.result() for one in of) for name, of in results.items()}
    total = dict.fromkeys((*BARS, *FINDING_KINDS), 0)
    for name, one in found.items():
        one["unit"] = known[name].unit
        total[one["unit"]] += one["inputs"]
        for kind in FINDING_KINDS:
            total[kind] += one[kind]
    report = {
        **harness.origin("onnx", "onnxruntime", "cantools", "PyYAML", "pydantic", "pyarrow"),
        "seed": options.seed,
        "run_s": round(time.monotonic() - started_s, 1),
        "bars": BARS,
        "in all": total,
        "targets": found,
    }
    harness.publish("fuzz.json", report, options)
    return 1 if any(total[kind] for kind in FINDING_KINDS) else 0


def _added(shares: Any) -> dict[str, Any]:
    counts: Counter[str] = Counter(dict.fromkeys(("items", *INPUTS, *FINDING_KINDS), 0))
    findings: list[str] = []
    for count, found in shares:
        counts.update(count)
        findings += found
    return {**counts, "findings": findings[:20]}


def watch(
    command: list[str], name: str, seed: int, first: int, end: int
) -> tuple[Counter[str], list[str]]:
    """Run items in child processes until all are done; gives counts and findings.

    `command` starts this script. A child that ends before its last item is a finding of that
    item; another child continues behind it.

    Raises:
        RuntimeError: a child does not start.
    """
    counts, findings = Counter[str](items=end - first), list[str]()
    while first < end:
        given = [*command, f"--seed={seed}", "--child", name, str(first), str(end)]
        with subprocess.Popen(given, stdout=subprocess.PIPE, text=True, cwd=Path.cwd()) as child:
            assert child.stdout is not None
            started = child.stdout.readline() == "ready\n"
            for line in child.stdout:
                done = json.loads(line)
                findings += done.pop("finding", [])
                counts.update(done)
                first += 1
        if not started:
            raise RuntimeError(f"{name}: its child did not start ({child.returncode})")
        if first < end:
            counts["ended"] += 1
            findings.append(f"{name} item {first}: its process ended with {child.returncode}")
            first += 1
    return counts, findings


def run_items(target: Target, seed: int, items: range) -> None:
    """Run items in this process, and print a line of JSON for each."""
    run = target.make(seed)
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # readers print warnings of what they left out
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + int(GROWTH_LIMIT_MB * 1e6)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    out.write("ready\n")
    for item in items:
        faulthandler.dump_traceback_later(ITEM_LIMIT_S, exit=True)
        done: dict[str, Any]
        try:
            done = dict(zip(INPUTS, run(item), strict=True))
        except FalseAnswerError as error:
            done = {"false_answers": 1, "finding": [f"item {item}: {error}"[:500]]}
        except BaseException:  # whatever escapes is a finding, also an exit
            where = " | ".join(traceback.format_exc().strip().splitlines()[-6:])
            done = {"escaped": 1, "finding": [f"item {item}: {where}"[:900]]}
        faulthandler.cancel_dump_traceback_later()
        out.write(json.dumps(done) + "\n")


if __name__ == "__main__":
    sys.exit(main())
