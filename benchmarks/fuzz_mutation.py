"""Mutations of bytes, text and trees of values, drawn from a `random.Random`.

A span, a token or a value is removed, repeated, exchanged with another one or with an extreme.
`hypothesis` stays with the tests: an item here has a number that makes it again by itself, in a
child process that it may end, and a million of them take minutes. The types of all targets are
here too.
"""

from __future__ import annotations

import copy
import random
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import yaml

from cablesense_base import CableSenseError

LONGEST_LINE = 1_200


class FalseAnswerError(AssertionError):
    """Invalid input was accepted as valid: the finding that fuzzing is for."""


class ItemOutcome(NamedTuple):
    """The frames, messages or files in an item, and how many were refused and taken."""

    inputs: int = 1
    refused: int = 0
    taken: int = 0


Run = Callable[[int], ItemOutcome]


class Target(NamedTuple):
    """One reader.

    Attributes:
        unit: of its inputs.
        make: gives, for a seed, what takes item after item; called in the child process.
        items, quick_items: in a full run, and in a quick one.
    """

    unit: str
    make: Callable[[int], Run]
    items: int
    quick_items: int


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


BINARY_NUMBERS = (
    *(struct.pack("<Q", n) for n in (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)),
    *(struct.pack("<I", n) for n in (0, 1, 2**16, 2**30, 2**31 - 1, 2**32 - 1)),
    *(struct.pack("<d", n) for n in (float("nan"), float("inf"), -float("inf"), 1e308, -1e308)),
    *(struct.pack("<f", n) for n in (float("nan"), float("inf"), 3e38)),
    b"\x00",
    b"\xff",
    b"\x80\x80\x80\x80\x80\x80\x80\x80\x80\x01",
)
TEXT_NUMBERS = (
    "nan", ".nan", "inf", "-.inf", ".inf", "1e999", "-1e999", "1e308", "0", "-0.0", "-1", "1e-320",
    "9" * 30, "9" * 400, "0x" + "f" * 40, "1_000", "1:30:00", "4294967296", "-9223372036854775809",
    "", "~", "true", "'1'", "[1]", "{a: 1}", "1,5", "١٢", "1 2", "[" * 30 + "1" + "]" * 30,
    "[" * 3_000 + "1" + "]" * 3_000, "{a: " * 30, "{a: " * 3_000,
)  # fmt: skip
WORDS = (
    "", "*a", "&a x", "!!python/object/apply:os.system [ls]", "!!binary aaaa", "<<", "|", ">-",
    "\0", "\u202e", "\x1b[31m", "\"", "'", "\\", "{", "}", "[" * 40, "- ", "#", "\ufeff",
    "../../x.dbc",
    "x" * 2_000, "\ud7ff", "%s%n", "=1+1", "--", ": ", ",", ";", "\r", "\t",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 10**40, -0.0, 1e-320, 1e308, -1e308,
    float("nan"), float("inf"), float("-inf"), "", "x", "x" * 5_000, "a\nb", "\u202e", "nan", [],
    {}, [[]], [1, [2, [3]]], [0.1] * 300, {"a": {"b": 1}}, {1: 2}, "../up.dbc", "1e5", "0x10",
)  # fmt: skip
_TOKENS = (
    (re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"), TEXT_NUMBERS),
    (re.compile(r"\w+|[^\w\s]"), WORDS),
    (re.compile(r".*\n|.+$"), ("", "\n")),
)


def mutated_bytes(
    rng: random.Random, data: bytes, others: Sequence[bytes] = (), most: int = 4
) -> bytes:
    """Between one and `most` changes of `data`; pieces may come from `others`."""
    for _ in range(rng.randint(1, most)):
        data = data or b"\0"
        at, end = _span(rng, data)
        match rng.randrange(8):
            case 0 | 1:  # bits turned
                changed = bytearray(data)
                for place in rng.choices(range(len(data)), k=rng.choice((1, 1, 2, 8))):
                    changed[place] ^= 1 << rng.randrange(8)
                data = bytes(changed)
                continue
            case 2:  # cut off
                piece, end = b"", len(data)
            case 3:  # cut out
                piece = b""
            case 4:  # repeated
                piece = data[at:end] * rng.randint(2, 4)
            case 5:
                other = rng.choice(others or (data,))
                piece = other[slice(*_span(rng, other))]
            case 6:
                piece = rng.choice(BINARY_NUMBERS)[:: rng.choice((1, 1, -1))]
                end = at + len(piece)
            case _:
                piece = rng.randbytes(rng.randint(1, 32))
        data = data[:at] + piece + data[end:]
    return data


def _span(rng: random.Random, data: bytes) -> tuple[int, int]:
    at = rng.randrange(len(data) + 1)
    return at, min(len(data), at + int(2 ** rng.uniform(0, 9)))


def mutated_text(rng: random.Random, text: str, others: Sequence[str] = ()) -> bytes:
    """Between one and three changes of `text`, a few of them of its bytes."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        pattern, extremes = rng.choice(_TOKENS)
        found = list(pattern.finditer(text))
        if not found:
            text += rng.choice(extremes)
            continue
        match = rng.choice(found)
        start, end, token = match.start(), match.end(), match[0]
        action = rng.randrange(8)
        if action <= 2:
            token = rng.choice(extremes)
        elif action == 3:
            token = rng.choice(pattern.findall(rng.choice(others or (text,))) or [token])
        elif action == 4:
            token *= rng.choice((0, 2, 3, 200))
        elif action == 5:
            token = rng.choice(("  ", "\t", "- ", *pattern.findall(text)[:40])) + token
        elif action == 6:
            end = len(text)
        elif extremes is TEXT_NUMBERS:
            token = f"{float(token) * rng.choice((-1, 1e-9, 0.5, 2, 1e3, 1e9, 1e30)):.10g}"
        else:
            token = ""
        text = text[:start] + token + text[end:]
    data = text.encode("utf-8", errors="surrogatepass")
    return mutated_bytes(rng, data, most=2) if rng.random() < 0.15 else data


def mutated_yaml(rng: random.Random, text: str) -> bytes:
    """The tree that `text` holds, mutated and written anew."""
    tree = mutated_tree(rng, yaml.safe_load(text))
    written: str = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
    return written.encode("utf-8", errors="surrogatepass")


def mutated_tree(rng: random.Random, tree: Any) -> Any:
    """The same dict or list after between one and three changes of its values, keys or depth."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = list(_places(tree))
        if not places:
            break
        holder, key = rng.choice(places)
        value = holder[key]
        match rng.randrange(7):
            case 0 | 1 | 2:
                holder[key] = copy.deepcopy(rng.choice(VALUES))
            case 3 if isinstance(value, float | int):
                holder[key] = value * rng.choice((-1, 0.5, 2, 1e3, 1e-3, 1e9))
            case 3:
                holder[key] = [value]
            case 4:
                del holder[key]
            case 5 if isinstance(holder, dict):
                holder[rng.choice(("", "x", f"{key}_", 3))] = holder.pop(key)
            case _:
                for _ in range(rng.choice((1, 5, 60))):
                    holder[key] = rng.choice(([holder[key]], {"a": holder[key]}))
    return tree


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
        yield tree, key
        if isinstance(value, dict | list):
            yield from _places(value)
