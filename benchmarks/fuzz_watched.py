"""A fuzzed target in child processes that may crash, hang or grow; each finding names its item.

A target takes items by their numbers. The child reports each item when it is done, and the parent
checks twenty times a second: a child that ends by itself, stays at one item too long or takes too
much memory is a finding of that item, and another child goes on behind it.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import random
import resource
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import NamedTuple

from harness import cpu_s, rss_mb

from cablesense_base import CableSenseError

LONGEST_LINE = 1_200
WAITS = 6.0
"""An item may wait for so many times its limit, and work for once: a busy machine delays all."""
START_LIMIT_S = 120.0
"""To import and to make what is fuzzed."""

FINDING_KINDS = ("crashes", "hangs", "memory", "escaped", "false_answers")
_CHECK_S = 0.05
_FINDINGS_KEPT = 20


class FalseAnswerError(AssertionError):
    """Invalid input was accepted as valid: the finding that fuzzing is for."""


class Outcome(NamedTuple):
    """Of one item: the frames, messages or files in it, and how many were refused and taken."""

    inputs: int = 1
    refused: int = 0
    taken: int = 0


Run = Callable[[int], Outcome]


@dataclass(frozen=True)
class Target:
    """One reader.

    Attributes:
        name, unit: of it, and of its inputs.
        make: gives, for a seed, what takes item after item; called in the child process.
        items, quick_items: in a full run, and in a quick one.
        limit_s: longest time for an item.
        growth_mb: most memory that a child may take beyond what it began with.
    """

    name: str
    unit: str
    make: Callable[[int], Run]
    items: int
    quick_items: int
    limit_s: float = 10.0
    growth_mb: float = 1_500.0


@dataclass
class Result:
    """Counts of one target, and its first findings."""

    items: int = 0
    inputs: int = 0
    refused: int = 0
    taken: int = 0
    longest_item_s: float = 0.0
    largest_growth_mb: float = 0.0
    crashes: int = 0
    hangs: int = 0
    memory: int = 0
    escaped: int = 0
    false_answers: int = 0
    findings: list[str] = field(default_factory=list)

    def add(self, other: Result) -> None:
        """Take another share of the same target's items in."""
        for name, value in vars(other).items():
            mine = getattr(self, name)
            setattr(self, name, max(mine, value) if "est_" in name else mine + value)

    def count(self, kind: str, finding: str) -> None:
        """Count a finding of a kind, and keep its text if it is among the first."""
        setattr(self, kind, getattr(self, kind) + 1)
        if len(self.findings) < _FINDINGS_KEPT:
            self.findings.append(finding)


def item_random(name: str, seed: int, item: int) -> random.Random:
    """The random numbers of one item, the same in every run with that seed."""
    return random.Random(f"{name}/{seed}/{item}")


def require_one_line(error: CableSenseError) -> None:
    """Check that a refusal is one line that can be printed.

    Raises:
        FalseAnswerError: it is not.
    """
    text = str(error)
    if not text or len(text) > LONGEST_LINE or len(text.splitlines()) != 1:
        raise FalseAnswerError(f"not a one-line refusal: {text[:300]!r} ({len(text)} characters)")


def run_watched(
    target: Target, seed: int, first: int, end: int, on_item: Callable[[], None]
) -> Result:
    """Items `first` to `end` - 1, each watched; calls `on_item` when one is done.

    Raises:
        RuntimeError: a child does not start.
    """
    result = Result(items=end - first)
    while first < end:
        reports, writer = multiprocessing.Pipe(duplex=False)
        child = multiprocessing.get_context("spawn").Process(
            target=_run_items, args=(target, seed, range(first, end), writer), daemon=True
        )
        child.start()
        writer.close()
        pid = child.pid or 0
        base_mb, failure = math.inf, ""
        since_s, worked_s = time.monotonic(), 0.0
        while first < end and not failure:
            if reports.poll(_CHECK_S):
                try:
                    report = reports.recv()
                except EOFError:
                    failure = "crashes"
                    break
                if isinstance(report, Result):
                    result.add(report)
                    first += 1
                    on_item()
                else:
                    base_mb = report  # the child is ready
                since_s, worked_s = time.monotonic(), cpu_s(pid)
            limit_s = START_LIMIT_S if base_mb == math.inf else target.limit_s
            waited_s = time.monotonic() - since_s
            if rss_mb(pid) - base_mb > target.growth_mb:
                failure = "memory"
            elif waited_s > limit_s and (
                cpu_s(pid) - worked_s > limit_s or waited_s > WAITS * limit_s
            ):
                failure = "hangs"
        if failure in ("hangs", "memory"):
            child.kill()
        child.join()
        reports.close()
        if base_mb == math.inf:
            raise RuntimeError(f"{target.name}: its child did not start ({child.exitcode})")
        if failure:
            found = f"{target.name} item {first}: {failure}, exit code {child.exitcode}"
            result.count(failure, found)
            first += 1
            on_item()
    return result


def _run_items(target: Target, seed: int, items: range, reports: Connection) -> None:
    run = target.make(seed)
    silence = os.open(os.devnull, os.O_WRONLY)  # readers print warnings of what they left out
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    base_mb = rss_mb(os.getpid())
    reports.send(base_mb)
    for item in items:
        began_s, done = time.monotonic(), Result()
        try:
            done.inputs, done.refused, done.taken = run(item)
        except FalseAnswerError as error:
            done.count("false_answers", f"{target.name} item {item}: {error}"[:500])
        except CableSenseError as error:
            done.count("escaped", f"{target.name} item {item}: not caught by its run: {error}")
        except BaseException:  # whatever escapes is a finding, be it an exit
            where = " | ".join(traceback.format_exc().strip().splitlines()[-6:])
            done.count("escaped", f"{target.name} item {item}: {where}"[:900])
        done.longest_item_s = time.monotonic() - began_s
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
        done.largest_growth_mb = max(0.0, peak_mb - base_mb)
        reports.send(done)
