"""`cablesense paper`: every study of the paper on this project's own parts, in one report."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cablesense_paper.study import study_names

if TYPE_CHECKING:
    from rich.progress import Progress

    from cablesense_paper.study import Outcome, Study


def paper(
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="New or empty folder for report.html, results.json and pictures."
        ),
    ],
    quick: Annotated[
        bool,
        typer.Option(
            "--quick", help="Fewer samples and coarser sweeps: under two minutes on two cores."
        ),
    ] = False,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help=f"Only this study; repeatable. Names: {', '.join(study_names())}."
        ),
    ] = None,
) -> None:
    """Repeat the paper's experiments here, and show each result beside the paper's.

    Every study runs on this project's own simulation. The report states for each number that the
    paper gives whether ours agrees, and why it does or does not. Open DIR/report.html in any
    browser; it needs nothing beside it. The report lists a study that fails, the others still
    run, and the command ends with 1.

    Examples: [bold]cablesense paper --out paper --quick[/bold],
    [bold]cablesense paper --out friction --only friction[/bold]
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from cablesense_paper.report import claim_folder, write_report
    from cablesense_paper.study import FailedStudyError, chosen_studies, require_drawing

    require_drawing()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads that wait for each other cost minutes
    studies = chosen_studies(only or ())
    claim_folder(out)
    console = Console()
    columns = (TextColumn("{task.description:36}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        outcomes = [_followed(study, quick, progress) for study in studies]
    write_report(out, outcomes, quick)
    console.print(f"Report: {out / 'report.html'}", soft_wrap=True)
    failed = [outcome.study.name for outcome in outcomes if outcome.failure]
    if failed:
        raise FailedStudyError(
            f"{len(failed)} of {len(studies)} studies failed: {', '.join(failed)}; "
            f"{out / 'report.html'} says why"
        )


def _followed(study: Study, quick: bool, progress: Progress) -> Outcome:
    """Run a study under a bar with its title."""
    from cablesense_paper.study import run_study

    task = progress.add_task(study.title, total=1.0)

    def tell(done: float) -> None:
        progress.update(task, completed=done)

    outcome = run_study(study, quick, tell)
    tell(1.0)
    return outcome
