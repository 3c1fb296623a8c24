"""What fuzzing shares: targets, and edits of bytes, text and sequences, drawn by `hypothesis`."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hypothesis import strategies as st

from cablesense_base import CableSenseError

LONGEST_LINE = 1_200
Draw = Callable[[st.SearchStrategy[Any]], Any]


class FalseAnswerError(AssertionError):
    """Invalid input was accepted as valid: the finding that fuzzing is for."""


class Tally(NamedTuple):
    """The frames, messages or files of an example, and how many were refused and taken."""

    inputs: int = 1
    refused: int = 0
    taken: int = 0


Check = Callable[[Draw], Tally]
"""Draws an example, gives it to a reader, and judges the answer."""


class Target(NamedTuple):
    """One reader: the unit of its inputs, its check, and how many examples."""

    unit: str
    check: Check
    examples: int


def require(true: object, otherwise: str) -> None:
    """Raise a `FalseAnswerError` with this text where something is not true."""
    if not true:
        raise FalseAnswerError(otherwise)


def require_one_line(error: CableSenseError) -> None:
    """Check that a refusal is one line that can be printed."""
    text = str(error)
    printable = len(text) <= LONGEST_LINE and len(text.splitlines()) == 1
    require(printable, f"not a one-line refusal: {text[:300]!r} ({len(text)} characters)")


_SPANS = (1, 1, 1, 2, 4, 12, 64, 512)
_EDITS = ("left out", "cut off", "repeated", "moved", "exchanged", "exchanged", "exchanged")


def edited(
    draw: Draw,
    content: Sequence[Any],
    others: st.SearchStrategy[Sequence[Any]] | None = None,
    most: int = 4,
) -> list[Any]:
    """A sequence after up to `most` changes of spans, some exchanged with `others`."""
    items = list(content)
    for _ in range(draw(st.integers(1, most))):
        begin = draw(st.integers(0, len(items)))
        end = begin + draw(st.sampled_from(_SPANS))
        piece = items[begin:end]
        match draw(st.sampled_from(_EDITS)):
            case "left out":
                piece = []
            case "cut off" if begin > len(items) // 2:
                piece = []
                end = len(items)
            case "repeated":
                piece *= draw(st.sampled_from((2, 3, 200 if len(piece) == 1 else 2)))
            case "exchanged" if others is not None:
                piece = list(draw(others))
            case _:  # moved
                del items[begin:end]
                begin = draw(st.integers(0, len(items)))
                end = begin
        items[begin:end] = piece
    return items


_BINARY = st.binary(min_size=1, max_size=32) | st.sampled_from(
    (
        *(struct.pack("<Q", n) for n in (0, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)),
        *(struct.pack("<I", n) for n in (0, 1, 2**16, 2**30, 2**32 - 1)),
        *(struct.pack("<d", n) for n in (float("nan"), float("inf"), -1e308)),
        b"\x80\x80\x80\x80\x80\x80\x80\x80\x80\x01",
    )
)


def edited_bytes(draw: Draw, content: bytes, most: int = 4) -> bytes:
    """Bytes with spans changed, some for other numbers."""
    return bytes(edited(draw, content, _BINARY, most))


NUMBERS = (
    "nan",
    ".nan",
    "inf",
    "-.inf",
    "1e999",
    "1e308",
    "0",
    "-0.0",
    "-1",
    "1e-320",
    "0.5",
    "1e9",
    "9" * 30,
    "9" * 400,
    "0x" + "f" * 40,
    "1_000",
    "1:30:00",
    "4294967296",
    "-9223372036854775809",
    "",
    "~",
    "true",
    "'1'",
    "[1]",
    "{a: 1}",
    "{}",
    "1,5",
    "١٢",
    "1 2",
    "[" * 30 + "1" + "]" * 30,
    "[" * 3_000 + "1" + "]" * 3_000,
    "{a: " * 3_000,
    "null",
    '"nan"',
    str([0.1] * 300),
)
WORDS = (
    "*a",
    "&a x",
    "!!python/object/apply:os.system [ls]",
    "!!binary aaaa",
    "<<",
    "|",
    ">-",
    "\0",
    "\u202e",
    "\x1b[31m",
    '"',
    "'",
    "\\",
    "{",
    "}",
    "[" * 40,
    "- ",
    "#",
    "\ufeff",
    "../../x.dbc",
    "x" * 2_000,
    "\ud7ff",
    "%s%n",
    "=1+1",
    "--",
    ": ",
    ",",
    ";",
    "\r",
    "\t",
    "\n",
)
_TOKENS = re.compile(r"\n|[^\S\n]+|-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|\w+|[^\w\s]")


def edited_text(draw: Draw, content: bytes, words: Sequence[str] = ()) -> bytes:
    """Text with lines or tokens changed, some for extremes or for `words`, a few of its bytes."""
    text = content.decode("utf-8")
    whole_lines = draw(st.booleans())
    parts = text.splitlines(keepends=True) if whole_lines else _TOKENS.findall(text)
    extremes = st.sampled_from((*NUMBERS, *WORDS, *words)).map(lambda word: [word])
    data = "".join(edited(draw, parts, extremes, most=3)).encode("utf-8", errors="surrogatepass")
    return edited_bytes(draw, data, most=2) if draw(st.integers(0, 6)) == 6 else data
