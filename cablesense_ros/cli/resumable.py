"""Runs that go on where the same command was interrupted (`KeptSimulations.of_command`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from cablesense_gap.kept_simulations import KeptSimulations


@contextmanager
def resumable(
    out: Path, inputs: Iterable[Path], settings: Sequence[object], console: Console
) -> Iterator[KeptSimulations]:
    """What the same command has simulated before it was interrupted; deleted at a good end.

    `inputs` and `settings` are those on which predictions depend, so no processes and no --force.
    Prints whether it goes on, and where it is interrupted, how it will.
    """
    from cablesense_gap.kept_simulations import KeptSimulations

    kept = KeptSimulations.of_command(out, inputs, settings)
    if kept.count:
        _say(console, f"Going on from an interrupted run, with {kept.count} of its simulations.")
    try:
        yield kept
    except KeyboardInterrupt:
        if kept.folder.exists():
            _say(console, f"Kept in {kept.folder}: the same command goes on from there.")
        raise
    kept.delete()


def _say(console: Console, line: str) -> None:
    console.print(line, soft_wrap=True, markup=False, highlight=False)
