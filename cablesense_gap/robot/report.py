"""The folder that a diagnosis of a robot leaves: verdict, amended model and report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cablesense_gap.report.style import (
    AFTER,
    BEFORE,
    INK,
    WIDTH_IN,
    Line,
    as_uri,
    draw_lines,
    percent,
    rendered,
    size_text,
    style,
    with_interval,
)
from cablesense_gap.report.text import common_content, headline, write_common
from cablesense_gap.robot.amending import AMENDED_MODEL, BESIDE_MODEL, known_effects, write_amended
from cablesense_gap.robot.system import UNIT, RobotDiagnosis
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import Verdict, listed

ROBOT_FILES = ("verdict.json", AMENDED_MODEL, BESIDE_MODEL, "report.html")


def write_robot_diagnosis(
    folder: Path, found: RobotDiagnosis, beside: Mapping[Term, float]
) -> None:
    """Write all files, each whole or not at all.

    `beside` holds the effects of the nominal model's JSON file.

    Raises:
        VerdictError: the folder cannot be made, or the verdict not be written.
        RobotError: the amended model cannot be written.
        ReportError: the report cannot be written.
    """
    write_common(folder, found.verdict, report_page(found, folder.name))
    write_amended(folder, found.robot, found.amended, beside)


def robot_headline(verdict: Verdict) -> str:
    """The first line: what, where, how sure."""
    return headline(verdict, known_effects())


def floors(value: float) -> str:
    """`8.4 floors`."""
    return size_text(value, UNIT)


def report_page(found: RobotDiagnosis, folder: str) -> str:
    """The report as one self-contained HTML page."""
    verdict = found.verdict
    with style():
        overlay = _overlay(found)
    content = {
        **common_content(verdict, known_effects()),
        "trials": int(found.comparison.trial.max()) + 1,
        "folder": folder,
        "findings": found.findings,
        "forward": found.motion.forward,
        "external": found.motion.external,
        "overlay": overlay,
        "parameters": [
            (effect, " ".join(place or verdict.shares[effect].places), parameter, estimate)
            for name, estimate in verdict.parameters.items()
            for effect, *place, parameter in (name.split("."),)
        ],
    }
    filters: dict[str, Any] = {
        made.__name__: made for made in (floors, percent, with_interval, listed)
    }
    return rendered("cablesense_gap.robot", "report.html", content, filters)


def _overlay(found: RobotDiagnosis) -> str:
    """The trial with the largest gap, channel by channel."""
    import matplotlib.pyplot as plt

    compared = found.comparison
    gap = (((compared.readings - found.before) / compared.floor) ** 2).sum(1)
    worst = int(np.bincount(compared.trial, gap).argmax())
    rows = compared.trial == worst
    figure, axes = plt.subplots(
        len(compared.names), 1, figsize=(WIDTH_IN, 0.7 + 1.5 * len(compared.names)),
        sharex=True, squeeze=False, layout="constrained",
    )  # fmt: skip
    drawn: list[Line] = [
        (compared.readings, INK, 1.8, "measured"), (found.before, BEFORE, 1.2, "nominal model"),
    ]  # fmt: skip
    if not np.allclose(found.before, found.after):
        drawn.append((found.after, AFTER, 1.2, "amended model"))
    for c, name in enumerate(compared.names):
        lines = [(v[rows, c], colour, width, label) for v, colour, width, label in drawn]
        draw_lines(axes[c, 0], compared.time_s[rows], lines)
        axes[c, 0].set_title(name, pad=2)
        axes[c, 0].set_ylabel(compared.units[c])
    axes[-1, 0].set_xlabel("time, s")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return as_uri(figure)
