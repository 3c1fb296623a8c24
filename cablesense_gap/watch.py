"""A series of recordings of one machine, each against the first: what drifts, and since when."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from cablesense_base import CableSenseError
from cablesense_base.files import write_atomically
from cablesense_gap.report.style import AFTER, BEFORE, WIDTH_IN, image_bytes, style
from cablesense_gap.verdict import FittedNumber, Verdict, joined
from cablesense_recording.mcap_file import is_bag

WATCH_FILES = ("drift.csv", "drift.png")
_SUFFIXES = (".csv", ".csv.gz", ".mcap")
_MOST_NUMBERS = 8
"""Panels of a picture; the numbers that are named most often come first."""


class SeriesError(CableSenseError):
    """A folder that holds no series of recordings."""


def series(folder: Path) -> list[Path]:
    """The recordings of a folder by their names, which begin with dates.

    Raises:
        SeriesError: there are fewer than two.
    """
    names = folder.iterdir() if folder.is_dir() else []
    paths = sorted(
        path for path in names if path.name.endswith(_SUFFIXES) or (path.is_dir() and is_bag(path))
    )
    if len(paths) < 2:
        raise SeriesError(
            f"{folder}: holds {len(paths)} recordings; give a folder of two or more whose names "
            "begin with their dates, the healthy machine first"
        )
    return paths


def drift_table(verdicts: Sequence[Verdict]) -> pd.DataFrame:
    """One row for each recording: what changed, how surely, how large, and each number."""
    rows = [
        {
            "recording": v.recording,
            "effects": joined(v.effects),
            "probability": v.probability,
            "gap": v.gap.before_n,
            "floor": v.gap.floor_n,
            **{f"{name}, {each.unit}": each.value for name, each in _full_names(v).items()},
        }
        for v in verdicts
    ]
    return pd.DataFrame(rows)


def _full_names(verdict: Verdict) -> dict[str, FittedNumber]:
    """Numbers by effect, place and parameter, also where there is one place."""
    full_names = {}
    for name, fitted in verdict.parameters.items():
        effect, *place, parameter = name.split(".")
        full_names[".".join((effect, *(place or verdict.where.places[:1]), parameter))] = fitted
    return full_names


def write_drift(folder: Path, verdicts: Sequence[Verdict]) -> None:
    """Write the table and a picture of it, each whole or not at all.

    Raises:
        SeriesError: the place cannot be written to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    table = drift_table(verdicts)
    write_atomically(folder / WATCH_FILES[0], table.to_csv(index=False), SeriesError)
    write_atomically(folder / WATCH_FILES[1], _picture(table), SeriesError)


def _picture(table: pd.DataFrame) -> bytes:
    import matplotlib.pyplot as plt

    numbers = table.columns[5:]
    often = table[numbers].notna().sum().sort_values(ascending=False, kind="stable")
    shown = list(often.index[:_MOST_NUMBERS])
    positions = range(len(table))
    with style():
        figure, axes = plt.subplots(
            1 + len(shown),
            1,
            figsize=(WIDTH_IN, 1.2 + 1.3 * (1 + len(shown))),
            sharex=True,
            squeeze=False,
            layout="constrained",
        )
        axes[0, 0].plot(positions, table["gap"] / table["floor"], "o-", color=BEFORE)
        axes[0, 0].axhline(1.0, color=AFTER, lw=1.0)
        axes[0, 0].set_title("gap since the reference, by what the model leaves of it", pad=2)
        for panel, name in zip(axes[1:, 0], shown, strict=True):
            panel.plot(positions, table[name].fillna(0.0), "o-", color=AFTER)
            panel.set_title(name, pad=2)
        axes[-1, 0].set_xticks(positions, table["recording"], rotation=30, ha="right")
        return image_bytes(figure, "png")
