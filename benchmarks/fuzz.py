"""Mutated frames, messages and files into every reader: no crash, no hang, no false force.

    python benchmarks/fuzz.py [--quick] [--only frames,models] [--seed 0] [--workers 2] [--write]

More than 1,000,000 CAN frames, 100,000 messages to the estimator and 10,000 files; with `--write`
the figures go to benchmarks/results/fuzz.json, with `--only` those of the targets named. Every
target (`fuzz/targets.py`) runs in child processes that are watched (`fuzz/watched.py`): a crash of
native code, an item beyond its time, memory beyond measure, an error outside CableSense's family,
a refusal that is no line and an answer that the target's oracle calls false are findings, each
with its item, which `--seed` makes again. Some thousand messages also go over real Fast DDS
to a live node (`fuzz/live_node.py`).
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import harness
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from fuzz.watched import Result, Target, run_watched

RESULT = harness.RESULTS / "fuzz.json"
SHARES = 3
"""Into so many parts a full target is cut, which go to the workers."""
LIVE = "live node"
BARS = {"CAN frames": 1_000_000, "messages": 100_000, "files": 10_000}
_LIBRARIES = ("onnx", "onnxruntime", "cantools", "PyYAML", "pydantic", "pyarrow", "pandas")


def main() -> int:
    """Fuzz, tell, and write; 1 where anything was found."""
    from fuzz.targets import TARGETS  # not in the children, which import this file too

    options = _options([target.name for target in TARGETS])
    chosen = [t for t in TARGETS if not options.only or t.name in options.only]
    live = LIVE in options.only or (not options.only and not options.quick)
    started_s = time.monotonic()
    results = _run_all(chosen, options)
    if live:
        from fuzz.live_node import fuzz_live_node

        results[LIVE] = fuzz_live_node(options.seed, options.live_messages)
    report = _report(chosen, results, options, time.monotonic() - started_s)
    if options.write:
        harness.write_result(RESULT.name, report)
    print(json.dumps(report if options.json else report["in all"], indent=1))
    for result in results.values():
        for finding in result.findings:
            print(finding, file=sys.stderr)
    return 0 if all(result.clean for result in results.values()) else 1


def _options(names: Sequence[str]) -> argparse.Namespace:
    parser = harness.parser(__doc__, f"results/{RESULT.name}")
    parser.add_argument("--quick", action="store_true", help="some seconds instead of minutes")
    parser.add_argument("--only", default="", help=f"names with commas between, also '{LIVE}'")
    parser.add_argument("--seed", type=int, default=0, help="other seeds make other items")
    parser.add_argument("--workers", type=int, default=2, help="child processes at a time")
    parser.add_argument("--live-messages", type=int, default=4_000, help="over Fast DDS")
    parser.add_argument("--json", action="store_true", help="print every figure")
    options = parser.parse_args()
    options.only = [name for name in options.only.split(",") if name]
    unknown = set(options.only) - {*names, LIVE}
    if unknown:
        parser.error(f"no target {', '.join(sorted(unknown))}")
    if options.quick and options.write:
        parser.error("a quick run is not written")
    return options


def _run_all(chosen: list[Target], options: argparse.Namespace) -> dict[str, Result]:
    results = {target.name: Result() for target in chosen}
    with (
        Progress(
            TextColumn("{task.description:>14}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            disable=not sys.stderr.isatty(),
        ) as progress,
        ThreadPoolExecutor(options.workers) as workers,
    ):
        running = []
        for target in chosen:
            count = target.quick_items if options.quick else target.items
            task = progress.add_task(target.name, total=count)
            shares = 1 if options.quick else SHARES
            cuts = [count * i // shares for i in range(shares + 1)]
            for first, end in itertools.pairwise(cuts):
                hear: Callable[[int], None] = lambda n, task=task: progress.advance(task, n)  # type: ignore[misc]  # noqa: E731
                share = workers.submit(run_watched, target, options.seed, first, end, hear)
                running.append((target.name, share))
        for name, share in running:
            results[name].add(share.result())
    return results


def _report(
    chosen: list[Target], results: dict[str, Result], options: argparse.Namespace, run_s: float
) -> dict[str, Any]:
    units = {target.name: target.unit for target in chosen} | {LIVE: "messages"}
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
    found = ("crashes", "hangs", "memory", "escaped", "false_answers")
    return {
        **harness.origin("python benchmarks/fuzz.py --write", _LIBRARIES),
        "run_s": round(run_s, 1),
        "bars": BARS,
        "in all": {
            **inputs,
            **{n: sum(one[n] for one in by_target.values()) for n in found},
        },
        "targets": by_target,
    }


if __name__ == "__main__":
    sys.exit(main())
