"""A fuzzed target in child processes that may crash, hang or grow; each finding names its item.

A target is a function from an item's number to its outcome. The child notes the number of the
item in shared memory. The parent checks twenty times a second: a child that ends by a signal,
stays at one item too long or takes too much memory is a finding of that item; another child goes
on behind it.
"""

from __future__ import annotations

import multiprocessing
import os
import random
import resource
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

from harness import cpu_s, rss_mb

from cablesense_base.errors import CableSenseError

LONGEST_LINE = 1_200


class FalseAnswerError(AssertionError):
    """Invalid input was accepted as valid: the finding that fuzzing is for."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of an item.

    Attributes:
        inputs: frames, messages or files in it.
        refused: of these, with a message.
        taken: of these, as what they are.
    """

    inputs: int = 1
    refused: int = 0
    taken: int = 0


Run = Callable[[int], Outcome]


@dataclass(frozen=True)
class Target:
    """One reader.

    Attributes:
        name: of it.
        unit: what its inputs are.
        make: given the seed, what takes item after item; called in the child process.
        items: how many in a full run.
        quick_items: how many in a test.
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


def item_random(name: str, seed: int, item: int) -> random.Random:
    """The random numbers of one item, the same in every run with that seed."""
    return random.Random(f"{name}/{seed}/{item}")


def require_one_line(error: CableSenseError) -> None:
    """A refusal is for people: one line that can be printed.

    Raises:
        FalseAnswerError: it is not.
    """
    text = str(error)
    if not text or len(text) > LONGEST_LINE or len(text.splitlines()) != 1:
        raise FalseAnswerError(
            f"a refusal that is no line: {text[:300]!r} ({len(text)} characters)"
        )


WAITS = 6.0
"""An item may wait for so many times its limit, work for once."""
START_LIMIT_S = 120.0
"""To import and to make what is fuzzed."""

_LOOK_S = 0.05
_FINDINGS_KEPT = 20
_ITEM, _SINCE_S, _INPUTS, _REFUSED, _TAKEN, _LONGEST_S, _BASE_MB, _GROWTH_MB, _WORKED_S = range(9)


@dataclass
class Result:
    """Of one target."""

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
            largest = name in ("longest_item_s", "largest_growth_mb")
            setattr(self, name, max(mine, value) if largest else mine + value)


def run_watched(
    target: Target, seed: int, first: int, end: int, on_progress: Callable[[int], None]
) -> Result:
    """Items `first` to `end` - 1, each watched; `on_progress` gets how many more are done."""
    result = Result(items=end - first)
    at = first
    while at < end:
        at = _run_child(target, seed, at, end, result, on_progress)
    return result


def _run_child(
    target: Target,
    seed: int,
    first: int,
    end: int,
    result: Result,
    on_progress: Callable[[int], None],
) -> int:
    """Runs one child until it ends or must be ended; gives the item to go on with."""
    context = multiprocessing.get_context("spawn")
    shared = context.RawArray("d", 9)
    shared[_ITEM], shared[_SINCE_S] = -1.0, time.monotonic()
    reader, writer = context.Pipe(duplex=False)
    child = context.Process(
        target=_child, args=(target, seed, first, end, shared, writer), daemon=True
    )
    child.start()
    writer.close()
    told, stopped = first, ""
    while not stopped:
        child.join(_LOOK_S)
        while reader.poll():
            try:
                kind, text = reader.recv()
            except EOFError:
                break
            setattr(result, kind, getattr(result, kind) + 1)
            _keep(result, text)
        item, since_s = int(shared[_ITEM]), shared[_SINCE_S]
        if item > told:
            on_progress(item - told)
            told = item
        if not child.is_alive():
            break
        if item >= 0 and _hangs(child.pid or 0, shared, target.limit_s):
            stopped = "hangs"
        elif item < 0 and time.monotonic() - since_s > START_LIMIT_S:
            raise RuntimeError(f"{target.name}: its child does not start")
        elif shared[_BASE_MB] and rss_mb(child.pid or 0) - shared[_BASE_MB] > target.growth_mb:
            stopped = "memory"
    if stopped:
        child.kill()
        child.join()
    reader.close()
    item = int(shared[_ITEM])
    if not stopped and child.exitcode != 0:
        stopped = "crashes"
    if stopped:
        setattr(result, stopped, getattr(result, stopped) + 1)
        _keep(result, f"{target.name} item {item}: {stopped}, exit code {child.exitcode}")
    _add(result, shared)
    if item < first:
        raise RuntimeError(f"{target.name}: its child did not start (exit code {child.exitcode})")
    following = end if not stopped else item + 1
    on_progress(following - told)
    return following


def _hangs(pid: int, shared: Any, limit_s: float) -> bool:
    """Whether an item works for too long, or waits: on a busy machine all wait a while."""
    waited_s = time.monotonic() - shared[_SINCE_S]
    return waited_s > limit_s and (
        cpu_s(pid) - shared[_WORKED_S] > limit_s or waited_s > WAITS * limit_s
    )


def _keep(result: Result, text: str) -> None:
    if len(result.findings) < _FINDINGS_KEPT:
        result.findings.append(text)


def _add(result: Result, shared: Any) -> None:
    result.inputs += int(shared[_INPUTS])
    result.refused += int(shared[_REFUSED])
    result.taken += int(shared[_TAKEN])
    result.longest_item_s = max(result.longest_item_s, shared[_LONGEST_S])
    result.largest_growth_mb = max(result.largest_growth_mb, shared[_GROWTH_MB])


def _child(
    target: Target, seed: int, first: int, end: int, shared: Any, writer: Connection
) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)  # readers tell people what they left out
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    run = target.make(seed)
    shared[_BASE_MB] = base_mb = rss_mb(os.getpid())
    for item in range(first, end):
        shared[_WORKED_S] = time.process_time()
        started_s = shared[_SINCE_S] = time.monotonic()
        shared[_ITEM] = item
        try:
            outcome = run(item)
        except FalseAnswerError as error:
            writer.send(("false_answers", f"{target.name} item {item}: {error}"[:500]))
            continue
        except CableSenseError as error:
            writer.send(("escaped", f"{target.name} item {item}: not caught by its run: {error}"))
            continue
        except BaseException:  # whatever escapes is a finding, be it an exit
            where = traceback.format_exc().strip().splitlines()
            writer.send(("escaped", f"{target.name} item {item}: {' | '.join(where[-6:])}"[:900]))
            continue
        finally:
            shared[_LONGEST_S] = max(shared[_LONGEST_S], time.monotonic() - started_s)
        shared[_INPUTS] += outcome.inputs
        shared[_REFUSED] += outcome.refused
        shared[_TAKEN] += outcome.taken
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    shared[_GROWTH_MB] = max(0.0, peak_mb - base_mb)
