"""The tutorial's command lines, typed in order, and the text that it says they print."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path

from typer.testing import CliRunner

from cablesense_ros.cli.app import app
from tests.helpers.checkout import CHECKOUT

PAGE = CHECKOUT / "docs/tutorial.md"
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ELSEWHERE = ("make ", ". .venv")
"""What other tests run, or what runs the tests."""
OF_THE_CLOCK = re.compile(r"━|^This takes about ")
"""Printed lines that say how long something takes."""
NUMBER = re.compile(r"\d+(?:\.(\d+))?")
WIDTH = 100
IDENTITY = re.compile(r"-[0-9a-f]{12}\b")


@dataclass(frozen=True)
class Step:
    """Command lines of one block of the page, and what it says that they print.

    Attributes:
        lines: as they are typed, each on one line.
        printed: the text block below them; `None` where there is none.
        span: where that text stands in the page, as first and last position.
    """

    lines: tuple[str, ...]
    printed: str | None
    span: tuple[int, int]


def steps(page: str) -> list[Step]:
    """Read the blocks of the page in their order."""
    read: list[Step] = []
    for block in FENCED.finditer(page):
        language, text = block.groups()
        if language == "text":
            last = read.pop()
            read.append(Step(last.lines, text, block.span(2)))
        elif not language:
            lines = tuple(text.replace("\\\n", "").splitlines())
            read.append(Step(lines, None, (block.end(), block.end())))
    return read


def typed(lines: tuple[str, ...], folder: Path) -> str:
    """Type lines in a folder; give what they print, without what depends on the clock.

    Raises:
        RuntimeError: a line has failed.
    """
    texts = [_typed(line, folder) for line in lines if not line.startswith(ELSEWHERE)]
    kept = [line for text in texts for line in text.splitlines() if not OF_THE_CLOCK.search(line)]
    shown = [part for line in kept for part in _folded(line.rstrip())]
    return "".join(f"{line}\n" for line in shown)


def differences(said: str, printed: str) -> Iterator[str]:
    """Name each word of a page that is another than the printed one.

    A number may be off by one in the last digit that the page shows.
    """
    said_words = IDENTITY.sub("", said).split()
    printed_words = IDENTITY.sub("", printed).split()
    if len(said_words) != len(printed_words):
        yield f"the page says\n{said}\nand the commands print\n{printed}"
        return
    for ours, theirs in zip(said_words, printed_words, strict=True):
        if NUMBER.sub("#", ours) != NUMBER.sub("#", theirs) or _numbers_differ(ours, theirs):
            yield f"the page says {ours!r}, the commands print {theirs!r}"


def _numbers_differ(ours: str, theirs: str) -> bool:
    """Whether numbers in two words are apart by more than the last digit of the first."""
    pairs = zip(NUMBER.finditer(ours), NUMBER.finditer(theirs), strict=True)
    return any(
        abs(float(number[0]) - float(other[0])) > 1.01 * 10.0 ** -len(number[1] or "")
        for number, other in pairs
    )


def _folded(line: str) -> list[str]:
    """A line as a terminal of `WIDTH` columns shows it, with words kept whole."""
    if len(line) <= WIDTH:
        return [line]
    return textwrap.wrap(line, WIDTH, break_long_words=False, break_on_hyphens=False)


def _typed(line: str, folder: Path) -> str:
    """Type one line; a verb runs in this process, as its modules take seconds to import."""
    command, _, file = line.partition(" > ")
    name, *words = shlex.split(command)
    if name != "cablesense":
        program = sys.executable if name == "python" else name
        done = subprocess.run(
            [program, *words],
            capture_output=True,
            check=False,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(CHECKOUT), *sys.path])},
            text=True,
        )
        if done.returncode:
            raise RuntimeError(f"{line}: {done.stderr}")
        return done.stdout if name == "cat" else ""
    with chdir(folder):
        verb = CliRunner().invoke(app, words)
    if verb.exit_code:
        raise RuntimeError(f"{line}: {verb.output} {verb.exception}")
    if file:
        (folder / file).write_text(verb.stdout, encoding="utf-8")
        return ""
    return verb.stdout
