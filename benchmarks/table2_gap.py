"""The gap between Table II's physical rows and this project's simulation of the same loads.

    python benchmarks/table2_gap.py [--tables 40] [--out benchmarks/table2] [--workers 2] [--ship]

54 measured changes of tension: nine cables, 1 and 2 kg on each of three segments. Writes
`verdict.json`, `README.md` and `report.html`, the page of `cablesense paper --only sim_to_real`
with what that leaves out. Explanations are fitted to some rows and judged on others; `--tables` of
each kind are simulated and diagnosed in the same way for the probability (0 takes the counts that
ship). `--ship` also writes their counts where `cablesense paper --quick` finds them.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cablesense_base import CableSenseError
from cablesense_base.files import write_atomically
from cablesense_gap.report.style import image_bytes, newtons, percent, style
from cablesense_gap.verdict import listed, write_verdict
from cablesense_paper.drawing import SERIES, one_panel
from cablesense_paper.report import paper_page
from cablesense_paper.studies.sim_to_real import (
    best_listed_n,
    figures_of,
    load_names,
    numbers_of,
    rms,
    shares,
)
from cablesense_paper.study import (
    PRINT_DPI,
    Outcome,
    Picture,
    SmallTable,
    StudyResult,
    chosen_studies,
    study_result,
)
from cablesense_paper.table_2_gap import FOLDS, REHEARSAL, TableDiagnosis, diagnose_table
from cablesense_paper.tension_changes import held_out_of_best, moments_n_m

README = Path(__file__).with_name("table2_readme.md")
_NEXT = "What to measure next. "


def main() -> None:
    """Diagnoses, prints the README and writes the files."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tables", type=int, default=40, help="simulated tables of each kind")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "table2")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--ship", action="store_true", help=f"write {REHEARSAL.name} too")
    options = parser.parse_args()
    began = time.perf_counter()
    found = diagnose_table(options.tables, _show_progress, options.workers)
    with style():
        result = extended(found)
    (study,) = chosen_studies(["sim_to_real"])
    options.out.mkdir(parents=True, exist_ok=True)
    outcome = Outcome(study, result, "", time.perf_counter() - began)
    page = paper_page([outcome], quick=not options.tables)
    write_atomically(options.out / "report.html", page, CableSenseError)
    *reasons, _, _, _, following = result.notes
    stated = {"why": tuple(reasons), "next_experiment": following.removeprefix(_NEXT)}
    write_verdict(options.out / "verdict.json", found.verdict.model_copy(update=stated))
    command = f"python benchmarks/table2_gap.py {' '.join(sys.argv[1:])}".strip()
    text = readme(found, result, command)
    write_atomically(options.out / "README.md", text, CableSenseError)
    if options.ship:
        counts = found.rehearsal.model_dump_json(indent=1) + "\n"
        write_atomically(REHEARSAL, counts, CableSenseError)
    print(text)


def _show_progress(done: float) -> None:
    print(f"\r{done:.0%} …", end="", file=sys.stderr, flush=True)


def extended(found: TableDiagnosis) -> StudyResult:
    """The study's result with the moments, the mistaken effects and the paper's simulation."""
    result = study_result("sim_to_real", numbers_of(found), figures_of(found))
    moments = SmallTable(
        "Moment carried, over that of the known load.",
        ("load", "joint 1", "joint 2", "joint 3"),
        tuple(
            (name, *("–" if np.isnan(v) else f"{100 * v:.0f} %" for v in row))
            for name, row in zip(load_names(found), moment_ratios(found), strict=True)
        ),
    )
    counts = sorted(found.rehearsal.mistaken, key=lambda case: (-case[2], case[:2]))
    mistaken = SmallTable(
        "Simulated tables with one listed effect that was mistaken for another.",
        ("true effect", "mistaken for", "tables"),
        tuple((*(name.replace("_", " ") for name in names), n) for *names, n in counts),
    )
    picture = Picture(
        name="sim_to_real_paper",
        png=image_bytes(paper_figure(found), "png", PRINT_DPI),
        caption="The paper's simulated change less ours, one line a load.",
        alt="The paper's simulated rows less ours, by cable",
    )
    return replace(
        result,
        pictures=(*result.pictures, picture),
        tables=(*result.tables, moments, mistaken),
    )


def moment_ratios(found: TableDiagnosis) -> Any:
    """(6, 3) pitch moments about each joint over those of the known load; NaN where none are."""
    expected = moments_n_m(found.arm, found.nominal_n)[:, ::2]
    carried = moments_n_m(found.arm, found.changes.changes_n)[:, ::2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.abs(expected) > 1e-3, carried / expected, np.nan)


def paper_figure(found: TableDiagnosis) -> Any:
    """The paper's simulated changes less ours, by cable."""
    figure, axes = one_panel(2.6, grid="y")
    cables = np.arange(1, 10)
    lines = zip(load_names(found), found.paper_n - found.nominal_n, strict=True)
    for k, (name, apart) in enumerate(lines):
        axes.plot(
            cables, apart, marker="osD"[k % 3], ms=5, lw=1.2, color=SERIES[k % 3],
            ls="-" if k < 3 else "--", label=name,
        )  # fmt: skip
    axes.axhline(0.0, color="black", lw=0.7)
    axes.set(xlabel="cable", ylabel="N", xticks=cables)
    figure.legend(loc="outside right center")
    return figure


def readme(found: TableDiagnosis, result: StudyResult, command: str) -> str:
    """The result in Markdown."""
    *reasons, slack, resolution, paper, following = result.notes
    measured, gap = found.changes.changes_n, found.verdict.gap
    gap_table = [
        f"| load | {' | '.join(str(i + 1) for i in range(9))} | RMS |",
        "| --- |" + " ---: |" * 10,
        *(
            f"| {name} | {' | '.join(f'{v:+.2f}' for v in row)} | {rms(row):.2f} |"
            for name, row in zip(load_names(found), found.gap_n, strict=True)
        ),
    ]
    left = {
        name: np.sqrt(held_out_of_best(found.scans, measured, fold).sum() / measured.size)
        for name, fold in FOLDS.items()
    }
    low, high = (100 * f(moment_ratios(found), axis=0) for f in (np.nanmin, np.nanmax))
    numbers = {
        **numbers_of(found),
        "command": command,
        "removed": percent(1 - best_listed_n(found) / gap.before_n),
        "gap_table": "\n".join(gap_table),
        "shares": "\n".join(f"- {percent(part)}: {what}" for what, part in shares(found).items()),
        "joints": [f"{a:.0f} to {b:.0f} %" for a, b in zip(low, high, strict=True)],
        "reasons": "\n".join(f"- {sentence}" for sentence in reasons),
        "folds": listed([f"{newtons(size)} with {name} held out" for name, size in left.items()]),
        "named": found.rehearsal.named,
        "slack": slack,
        "resolution": resolution,
        "paper": paper,
        "next": following.removeprefix(_NEXT),
    }
    return README.read_text(encoding="utf-8").format_map(numbers)


if __name__ == "__main__":
    main()
