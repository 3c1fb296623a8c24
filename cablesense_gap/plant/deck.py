"""Which kinds of cases a set has: nothing hidden, one thing, two, or something unheard of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil

import numpy as np

from cablesense_gap.plant.case import NONE
from cablesense_gap.plant.listed import LISTED
from cablesense_gap.plant.unlisted import UNLISTED

NONE_SHARE = 0.2
UNKNOWN_SHARE = 0.2
DOUBLE_SHARE = 0.12


def draw_kinds(rng: np.random.Generator, count: int, only: Sequence[str] = ()) -> list[str]:
    """Kinds of `count` cases for `draw_case`, in random order.

    At least a fifth hide nothing and a fifth something that no verdict has a name for; an eighth
    hides two effects, the rest one. Effects come in turn, so that none comes twice before all
    have come once. With `only`, those kinds in turn.
    """
    if only:
        return [only[i % len(only)] for i in range(count)]
    listed, unlisted = _in_turn(rng, list(LISTED)), _in_turn(rng, list(UNLISTED))
    none, unknown = ceil(NONE_SHARE * count), ceil(UNKNOWN_SHARE * count)
    doubles = round(DOUBLE_SHARE * count)
    singles = max(0, count - none - unknown - doubles)
    kinds = [NONE] * none
    kinds += [next(unlisted) for _ in range(unknown)]
    kinds += [next(listed) for _ in range(singles)]
    kinds += [_pair(listed) for _ in range(doubles)]
    return [kinds[i] for i in rng.permutation(len(kinds))][:count]


def _in_turn(rng: np.random.Generator, names: list[str]) -> Iterator[str]:
    while True:
        yield from (names[i] for i in rng.permutation(len(names)))


def _pair(names: Iterator[str]) -> str:
    first = next(names)
    second = next(name for name in names if name != first)
    return "+".join(sorted((first, second)))
