"""`cablesense gap score`: verdicts against the answers that were withheld."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from cablesense_gap.scoring.proportion import Proportion
    from cablesense_gap.scoring.score import Score


def score(
    verdicts: Annotated[
        Path,
        typer.Argument(
            metavar="DIR_OF_VERDICTS",
            help="Holds RECORDING/verdict.json, or RECORDING.json, for each row of the answers.",
        ),
    ],
    answers: Annotated[
        Path,
        typer.Option(help="CSV with recording, effects joined by +, and where."),
    ],
    json_output: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Score verdicts against answers: what was named right, how sure, how calibrated.

    Example: cablesense gap score verdicts --answers answers.csv --json
    """
    import json

    from rich.console import Console

    from cablesense_gap.scoring.answers import read_answers
    from cablesense_gap.scoring.score import score as score_verdicts
    from cablesense_gap.scoring.score_json import as_json
    from cablesense_gap.scoring.verdict_folder import read_verdicts

    listed = read_answers(answers)
    found = score_verdicts(read_verdicts(verdicts, [a.recording for a in listed]), listed)
    if json_output:
        print(json.dumps(as_json(found), indent=2))
        return
    console = Console()
    console.print(_figures(found))
    console.print(_confusion(found))


def _figures(found: Score) -> Table:
    from rich.table import Table

    table = Table("figure", "value", "95 % interval", "cases", title=f"{found.cases} verdicts")
    for name, share in (
        ("exact", found.exact),
        ("truth among the two most probable", found.top2),
        ("truth named or in the ambiguity group", found.truth_in_group),
        ("one effect: exact", found.singles_exact),
        ("one effect, gap at least 5 floors: exact", found.clear_singles_exact),
        ("two effects: both named", found.doubles_both),
        ("two effects: at least one named", found.doubles_one),
        ("none: false alarms", found.false_alarms),
        ("unknown: recognised", found.unknown_recall),
        ("right places, of correct verdicts", found.where),
        *((f"exact, {effect}", share) for effect, share in found.by_effect.items()),
    ):
        table.add_row(name, *_cells(share))
    removed = found.median_removed_fraction
    for name, value in (
        ("removable gap removed, median of correct verdicts", removed),
        ("mean probability on the truth", found.mean_probability_on_truth),
        ("Brier score of the verdicts", found.calibration.brier),
        ("expected calibration error", found.calibration.expected_error),
    ):
        table.add_row(name, "–" if value is None else f"{value:.3f}", "", str(found.cases))
    return table


def _cells(share: Proportion) -> tuple[str, str, str]:
    if share.value is None:
        return "–", "", "0"
    low, high = share.ci95
    return f"{share.value:.1%}", f"{low:.0%} to {high:.0%}", f"{share.hits} of {share.count}"


def _confusion(found: Score) -> Table:
    from rich.table import Table

    table = Table("truth", "verdicts", title="confusion")
    for truth, said in found.confusion.items():
        counts = sorted(said.items(), key=lambda pair: (pair[0] != truth, -pair[1], pair[0]))
        table.add_row(truth, ", ".join(f"{count} × {name}" for name, count in counts))
    return table
