"""What is fuzzed: a function from an item's number to what became of it."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

from cablesense_msgs_py.errors import CableSenseError

LONGEST_LINE = 1_200


class FalseAnswerError(AssertionError):
    """Something was believed that must not be: the finding that fuzzing is for."""


@dataclass(frozen=True)
class Outcome:
    """What became of an item.

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
    """

    name: str
    unit: str
    make: Callable[[int], Run]
    items: int
    quick_items: int
    limit_s: float = 10.0


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
