"""Text changed where it means something: numbers, words, quotes and lines."""

from __future__ import annotations

import random
import re
from collections.abc import Sequence

from fuzz.byte_mutation import mutated_bytes

NUMBERS = (
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
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(r"\w+|[^\w\s]")


def mutated_text(rng: random.Random, text: str, others: Sequence[str] = ()) -> bytes:
    """Between one and three changes of `text`, a few of them of its bytes."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        text = rng.choice(_CHANGES)(rng, text, others or (text,))
    data = text.encode("utf-8", errors="surrogatepass")
    return mutated_bytes(rng, data, most=2) if rng.random() < 0.15 else data


def _replaced(rng: random.Random, text: str, pattern: re.Pattern[str], by: Sequence[str]) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text + rng.choice(by)
    match = rng.choice(found)
    return text[: match.start()] + rng.choice(by) + text[match.end() :]


def _number(rng: random.Random, text: str, others: Sequence[str]) -> str:
    return _replaced(rng, text, _NUMBER, NUMBERS)


def _scaled(rng: random.Random, text: str, others: Sequence[str]) -> str:
    found = list(_NUMBER.finditer(text))
    if not found:
        return text
    match = rng.choice(found)
    value = float(match[0]) * rng.choice((-1.0, 1e-9, 0.5, 2.0, 1e3, 1e9, 1e30))
    return text[: match.start()] + f"{value:.10g}" + text[match.end() :]


def _word(rng: random.Random, text: str, others: Sequence[str]) -> str:
    known = [match[0] for match in _WORD.finditer(rng.choice(others))]
    return _replaced(rng, text, _WORD, (*WORDS, *known[:: max(1, len(known) // 40)]))


def _line(rng: random.Random, text: str, others: Sequence[str]) -> str:
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


def _cut(rng: random.Random, text: str, others: Sequence[str]) -> str:
    return text[: rng.randrange(len(text) + 1)]


def _nest(rng: random.Random, text: str, others: Sequence[str]) -> str:
    depth = rng.choice((3, 30, 3_000))
    return _replaced(rng, text, _NUMBER, ("[" * depth + "1" + "]" * depth, "{a: " * depth))


_CHANGES = (_number, _number, _scaled, _word, _word, _line, _line, _cut, _nest)
