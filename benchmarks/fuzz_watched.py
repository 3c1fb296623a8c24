"""A fuzzed target in child processes that may crash, hang or grow; each finding names its item.

A target is a function from an item's number to its outcome. The child notes the item's number in
shared memory, and the parent checks twenty times a second: a child that ends by a signal, stays
at one item too long or takes too much memory is a finding of that item, and another child goes on
behind it.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import random
import resource
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from harness import cpu_s, rss_mb

from cablesense_base.errors import CableSenseError

LONGEST_LINE = 1_200
WAITS = 6.0
"""An item may wait for so many times its limit, and work for once: a busy machine delays all."""
START_LIMIT_S = 120.0
"""To import and to make what is fuzzed."""

_CHECK_S = 0.05
_FINDINGS_KEPT = 20
_MOST = ("longest_item_s", "largest_growth_mb")
"""Of a result, what is the largest of its shares, and not their sum."""


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
        name: of it.
        unit: of its inputs.
        make: gives, for a seed, what takes item after item; called in the child process.
        items: in a full run.
        quick_items: in a quick run.
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

    @property
    def clean(self) -> bool:
        """Nothing was found."""
        return not (
            self.crashes or self.hangs or self.memory or self.escaped or self.false_answers
        )

    def add(self, other: Result) -> None:
        """Take another share of the same target's items in."""
        for name, value in vars(other).items():
            mine = getattr(self, name)
            setattr(self, name, max(mine, value) if name in _MOST else mine + value)

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
    target: Target, seed: int, first: int, end: int, on_progress: Callable[[int], None]
) -> Result:
    """Items `first` to `end` - 1, each watched; `on_progress` gets how many more are done."""
    result = Result(items=end - first)
    while first < end:
        first = _run_child(target, seed, first, end, result, on_progress)
    return result


class _Shared(ctypes.Structure):
    """What the child notes: the item, when it began, processor time then, and its sums."""

    _names = ("item", "since_s", "worked_s", "base_mb", *Outcome._fields, *_MOST)
    _fields_ = [(name, ctypes.c_double) for name in _names]


def _run_child(
    target: Target,
    seed: int,
    first: int,
    end: int,
    result: Result,
    on_progress: Callable[[int], None],
) -> int:
    """Run one child until it ends or must be ended; gives the item to go on with."""
    context = multiprocessing.get_context("spawn")
    shared = context.RawValue(_Shared, -1.0, time.monotonic())
    reader, writer = context.Pipe(duplex=False)
    child = context.Process(
        target=_child, args=(target, seed, first, end, shared, writer), daemon=True
    )
    child.start()
    writer.close()
    reported, stopped = first, ""
    while not stopped:
        child.join(_CHECK_S)
        while reader.poll():
            try:
                result.count(*reader.recv())
            except EOFError:
                break
        if shared.item > reported:
            on_progress(int(shared.item) - reported)
            reported = int(shared.item)
        if not child.is_alive():
            break
        assert child.pid is not None
        waited_s = time.monotonic() - shared.since_s
        worked_s = cpu_s(child.pid) - shared.worked_s
        if shared.item < 0 and waited_s > START_LIMIT_S:
            raise RuntimeError(f"{target.name}: its child does not start")
        if shared.item >= 0 and (
            (waited_s > target.limit_s and worked_s > target.limit_s)
            or waited_s > WAITS * target.limit_s
        ):
            stopped = "hangs"
        elif shared.base_mb and rss_mb(child.pid) - shared.base_mb > target.growth_mb:
            stopped = "memory"
    if stopped:
        child.kill()
        child.join()
    reader.close()
    item = int(shared.item)
    if not stopped and child.exitcode != 0:
        stopped = "crashes"
    if stopped:
        result.count(stopped, f"{target.name} item {item}: {stopped}, exit code {child.exitcode}")
    counts = {name: int(getattr(shared, name)) for name in Outcome._fields}
    result.add(Result(**counts, **{name: getattr(shared, name) for name in _MOST}))
    if item < first:
        raise RuntimeError(f"{target.name}: its child did not start (exit code {child.exitcode})")
    following = item + 1 if stopped else end
    on_progress(following - reported)
    return following


def _child(
    target: Target, seed: int, first: int, end: int, shared: Any, writer: Connection
) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)  # readers print warnings of what they left out
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    run = target.make(seed)
    shared.base_mb = base_mb = rss_mb(os.getpid())
    for item in range(first, end):
        shared.worked_s = time.process_time()
        started_s = shared.since_s = time.monotonic()
        shared.item = item
        try:
            outcome = run(item)
        except FalseAnswerError as error:
            writer.send(("false_answers", f"{target.name} item {item}: {error}"[:500]))
        except CableSenseError as error:
            writer.send(("escaped", f"{target.name} item {item}: not caught by its run: {error}"))
        except BaseException:  # whatever escapes is a finding, be it an exit
            where = traceback.format_exc().strip().splitlines()
            writer.send(("escaped", f"{target.name} item {item}: {' | '.join(where[-6:])}"[:900]))
        else:
            for name, value in outcome._asdict().items():
                setattr(shared, name, getattr(shared, name) + value)
        shared.longest_item_s = max(shared.longest_item_s, time.monotonic() - started_s)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    shared.largest_growth_mb = max(0.0, peak_mb - base_mb)
