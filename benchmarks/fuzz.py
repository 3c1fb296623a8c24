"""Mutated frames, messages and files into every reader: no crash, no hang, no false force.

    python benchmarks/fuzz.py [--quick] [--only frames,models] [--seed 0] [--workers 2] [--write]

More than 1,000,000 CAN frames, 100,000 messages to the estimator and 10,000 files; with `--write`
the counts go to benchmarks/results/fuzz.json, with `--only` those of the targets named. Every
target runs in child processes that are watched (`fuzz_watched.py`): a crash of native code, an
item beyond its time, memory beyond measure, an error outside CableSense's family, a refusal of
more than one line and an answer that the target's oracle calls false are findings, each with its
item, which `--seed` makes again. Some thousand messages also go over real Fast DDS to a live
node.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from datetime import UTC, datetime
from functools import partial
from typing import Any

import harness
from fuzz_watched import FINDING_KINDS, Result, Target, run_watched
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

RESULT = harness.RESULTS / "fuzz.json"
SHARES = 3
"""Parts of a full target, which go to the workers."""
LIVE = "live node"
BARS = {"CAN frames": 1_000_000, "messages": 100_000, "files": 10_000}
_LIBRARIES = ("onnx", "onnxruntime", "cantools", "PyYAML", "pydantic", "pyarrow", "pandas")


def targets() -> list[Target]:
    """All readers of what comes from outside."""
    from fuzz_files import FILE_TARGETS  # not in the children, which import this file too
    from fuzz_frames import make_frames
    from fuzz_messages import make_commands, make_messages

    return [
        Target("frames", "CAN frames", make_frames, 4_000, 12),
        Target("messages", "messages", make_messages, 1_050, 3),
        Target("commands", "messages", make_commands, 400, 3),
        *FILE_TARGETS,
    ]


def main() -> int:
    """Fuzz, print, and write; 1 where anything was found."""
    units = {target.name: target.unit for target in targets()} | {LIVE: "messages"}
    options = _options(list(units))
    chosen = [target for target in targets() if not options.only or target.name in options.only]
    started_s = time.monotonic()
    results = _run_all(chosen, options)
    if LIVE in options.only or not (options.only or options.quick):
        from fuzz_live import fuzz_live_node

        results[LIVE] = fuzz_live_node(options.seed, options.live_messages)
    report = _report(units, results, options, time.monotonic() - started_s)
    if options.write:
        harness.write_result(RESULT.name, report)
    print(json.dumps(report if options.json else report["in all"], indent=1))
    findings = [finding for result in results.values() for finding in result.findings]
    print(*findings, sep="\n", file=sys.stderr)
    return 1 if findings else 0


def _options(names: list[str]) -> argparse.Namespace:
    parser = harness.parser(__doc__, f"results/{RESULT.name}")
    parser.add_argument("--quick", action="store_true", help="some seconds instead of minutes")
    parser.add_argument("--only", default="", help=f"names with commas between, also '{LIVE}'")
    parser.add_argument("--seed", type=int, default=0, help="other seeds make other items")
    parser.add_argument("--workers", type=int, default=2, help="child processes at a time")
    parser.add_argument("--live-messages", type=int, default=4_000, help="over Fast DDS")
    parser.add_argument("--json", action="store_true", help="print every count")
    options = parser.parse_args()
    options.only = [name for name in options.only.split(",") if name]
    if unknown := set(options.only) - set(names):
        parser.error(f"no target {', '.join(sorted(unknown))}")
    if options.quick and options.write:
        parser.error("a quick run is not written")
    return options


def _run_all(chosen: list[Target], options: argparse.Namespace) -> dict[str, Result]:
    results = {target.name: Result() for target in chosen}
    shares = 1 if options.quick else SHARES
    columns = (TextColumn("{task.description:>14}"), BarColumn(), MofNCompleteColumn())
    console = Console(stderr=True)
    with (
        Progress(
            *columns, TimeRemainingColumn(), console=console, disable=not sys.stderr.isatty()
        ) as progress,
        ThreadPoolExecutor(options.workers) as workers,
    ):
        running = []
        for target in chosen:
            count = target.quick_items if options.quick else target.items
            on_item = partial(progress.advance, progress.add_task(target.name, total=count))
            cuts = [count * i // shares for i in range(shares + 1)]
            for first, end in itertools.pairwise(cuts):
                share = workers.submit(run_watched, target, options.seed, first, end, on_item)
                running.append((target.name, share))
        for name, share in running:
            results[name].add(share.result())
    return results


def _report(
    units: dict[str, str], results: dict[str, Result], options: argparse.Namespace, run_s: float
) -> dict[str, Any]:
    made = datetime.now(UTC).isoformat(timespec="seconds")
    by_target = {
        name: {"unit": units[name], "seed": options.seed, "made": made, **asdict(result)}
        for name, result in results.items()
    }
    if options.write and options.only and RESULT.exists():
        by_target = json.loads(RESULT.read_text())["targets"] | by_target
    inputs = dict.fromkeys(BARS, 0)
    for target in by_target.values():
        inputs[target["unit"]] += target["inputs"]
    found = {kind: sum(one[kind] for one in by_target.values()) for kind in FINDING_KINDS}
    return {
        **harness.origin(*_LIBRARIES),
        "run_s": round(run_s, 1),
        "bars": BARS,
        "in all": {**inputs, **found},
        "targets": by_target,
    }


if __name__ == "__main__":
    sys.exit(main())
