"""An item that is one file: written, read, and refused in one line or found to be usable."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Callable
from pathlib import Path

from cablesense_msgs_py.errors import CableSenseError
from fuzz.target import Outcome, Run, item_random, require_one_line

Make = Callable[[random.Random, int], tuple[bytes, str]]
Use = Callable[[Path], None]


def file_run(name: str, seed: int, make: Make, use: Use) -> Run:
    """Items are files: `make` gives bytes and suffix of one, `use` reads it and judges the answer.

    `use` raises `CableSenseError` for what is refused.
    """
    folder = tempfile.TemporaryDirectory(prefix="fuzz_")

    def run(item: int) -> Outcome:
        content, suffix = make(item_random(name, seed, item), item)
        path = Path(folder.name) / f"item{suffix}"
        path.write_bytes(content)
        try:
            use(path)
        except CableSenseError as error:
            require_one_line(error)
            return Outcome(refused=1)
        return Outcome(taken=1)

    return run
