"""Mutated bytes, text and YAML.

Bytes: bits turned, cut, repeated, mixed with others, numbers put in. Text: numbers, words and
lines changed. YAML: values, keys and branches of the tree changed.
"""

from __future__ import annotations

import copy
import random
import re
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import yaml

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
    "", "~", "true", "'1'", "[1]", "{a: 1}", "1,5", "١٢", "1 2",
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
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(r"\w+|[^\w\s]")


def mutated_bytes(
    rng: random.Random, data: bytes, others: Sequence[bytes] = (), most: int = 4
) -> bytes:
    """Between one and `most` changes of `data`; pieces may come from `others`."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, most)):
        _change_bytes(rng, changed, others or (data,))
    return bytes(changed)


def _span(rng: random.Random, data: bytes | bytearray) -> slice:
    at = rng.randrange(len(data) + 1)
    return slice(at, min(len(data), at + int(2 ** rng.uniform(0, 9))))


def _change_bytes(rng: random.Random, data: bytearray, others: Sequence[bytes]) -> None:
    action = rng.randrange(8)
    if action <= 1:
        for _ in range(rng.choice((1, 1, 2, 8))):
            if data:
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif action == 2:
        del data[rng.randrange(len(data) + 1) :]
    elif action == 3:
        del data[_span(rng, data)]
    elif action == 4:
        span = _span(rng, data)
        data[span.stop : span.stop] = bytes(data[span]) * rng.randint(1, 3)
    elif action == 5:
        other = rng.choice(others)
        piece = other[_span(rng, other)]
        data[_span(rng, data)] = piece
    elif action == 6:
        number = rng.choice(BINARY_NUMBERS)
        if rng.random() < 0.3:
            number = number[::-1]
        at = rng.randrange(len(data) + 1)
        data[at : at + len(number)] = number
    else:
        noise = rng.randbytes(rng.randint(1, 32))
        data[_span(rng, data)] = noise


def mutated_text(rng: random.Random, text: str, others: Sequence[str] = ()) -> bytes:
    """Between one and three changes of `text`, a few of them of its bytes."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        text = _changed_text(rng, text, others or (text,))
    data = text.encode("utf-8", errors="surrogatepass")
    return mutated_bytes(rng, data, most=2) if rng.random() < 0.15 else data


def _changed_text(rng: random.Random, text: str, others: Sequence[str]) -> str:
    action = rng.choice(range(9))
    if action <= 1:
        return _replaced(rng, text, _NUMBER, TEXT_NUMBERS)
    if action == 2:
        found = list(_NUMBER.finditer(text))
        if not found:
            return text
        match = rng.choice(found)
        value = float(match[0]) * rng.choice((-1.0, 1e-9, 0.5, 2.0, 1e3, 1e9, 1e30))
        return text[: match.start()] + f"{value:.10g}" + text[match.end() :]
    if action <= 4:
        known = [match[0] for match in _WORD.finditer(rng.choice(others))]
        return _replaced(rng, text, _WORD, (*WORDS, *known[:: max(1, len(known) // 40)]))
    if action <= 6:
        return _changed_line(rng, text, others)
    if action == 7:
        return text[: rng.randrange(len(text) + 1)]
    depth = rng.choice((3, 30, 3_000))
    return _replaced(rng, text, _NUMBER, ("[" * depth + "1" + "]" * depth, "{a: " * depth))


def _replaced(rng: random.Random, text: str, pattern: re.Pattern[str], by: Sequence[str]) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text + rng.choice(by)
    match = rng.choice(found)
    return text[: match.start()] + rng.choice(by) + text[match.end() :]


def _changed_line(rng: random.Random, text: str, others: Sequence[str]) -> str:
    lines = text.splitlines(keepends=True)
    if not lines:
        return text
    at = rng.randrange(len(lines))
    action = rng.randrange(5)
    if action == 0:
        del lines[at]
    elif action == 1:
        lines.insert(at, lines[rng.randrange(len(lines))])
    elif action == 2:
        other = rng.choice(others).splitlines(keepends=True) or ["\n"]
        lines.insert(at, rng.choice(other))
    elif action == 3:
        lines[at] = lines[at] * rng.choice((2, 3, 200))
    else:
        lines[at] = rng.choice(("  ", "\t", "- ")) + lines[at]
    return "".join(lines)


def mutated_yaml(rng: random.Random, text: str) -> bytes:
    """Between one and three changes of the tree that `text` holds, written anew."""
    tree = yaml.safe_load(text)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        _change_tree(rng, tree)
    written = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
    return written.encode("utf-8", errors="surrogatepass")


def _change_tree(rng: random.Random, tree: Any) -> None:
    holder, key = rng.choice(list(_places(tree)))
    action = rng.randrange(7)
    if action <= 2:
        holder[key] = copy.deepcopy(rng.choice(VALUES))
    elif action == 3:
        value = holder[key]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        holder[key] = value * rng.choice((-1, 0.5, 2, 1e3, 1e-3, 1e9)) if number else [value]
    elif action == 4:
        del holder[key]
    elif action == 5 and isinstance(holder, dict):
        holder[rng.choice(("", "x", f"{key}_", 3))] = holder.pop(key)
    else:
        for _ in range(rng.choice((1, 5, 60))):
            holder[key] = [holder[key]] if rng.random() < 0.5 else {"a": holder[key]}
    if isinstance(tree, dict) and not tree:
        tree["x"] = 1


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in list(items):
        yield tree, key
        if isinstance(value, dict | list):
            yield from _places(value)
