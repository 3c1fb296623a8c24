"""`python -m paper`: the paper's studies again, by one command."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cablesense_base.progress import task_bars
from cablesense_ros.cli.app import run_app
from cablesense_ros.cli.options import ForceOption, JsonOption, print_json


def _study_names() -> str:
    """Names of the studies, read from the files of their texts: loads no code."""
    texts = (Path(__file__).parent / "studies").glob("*.yaml")
    return ", ".join(sorted(text.stem for text in texts))


def studies(
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Folder for report.html, results.json and pictures; without --force a new or "
            "empty one.",
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
            metavar="NAME", help=f"Only this study; repeatable. Names: {_study_names()}."
        ),
    ] = None,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Repeat the paper's experiments here, and compare each result with the paper's.

    Every study runs on this project's own simulation. The report states for each number that the
    paper gives whether ours agrees, and why it does or does not. Open DIR/report.html in any
    browser; it needs no other file. The report lists a study that fails, the others still
    run, and the command ends with 1.

    Examples: [bold]python -m paper --out report --quick[/bold],
    [bold]python -m paper --out friction --only friction[/bold]
    """
    from paper.report import claim_folder, write_report
    from paper.study import FailedStudyError, chosen_studies, run_study

    for package in ("jinja2", "matplotlib"):  # missing ones are found now, not after minutes
        import_module(package)
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads that wait for each other cost minutes
    chosen = chosen_studies(only or ())
    claim_folder(out, force)
    console = Console(stderr=json_output)
    outcomes = []
    with task_bars() as bars:
        for study in chosen:
            show = bars.begin(study.title)
            outcomes.append(run_study(study, quick, show))
            show(1.0)
    results = write_report(out, outcomes, quick)
    if json_output:
        print_json(results)
    console.print(f"Report: {out / 'report.html'}", soft_wrap=True)
    failed = [outcome.study.name for outcome in outcomes if outcome.failure]
    if failed:
        raise FailedStudyError(
            f"{len(failed)} of {len(chosen)} studies failed: {', '.join(failed)}; "
            f"{out / 'report.html'} states why"
        )


app = typer.Typer(rich_markup_mode="rich", add_completion=False)
app.command()(studies)

if __name__ == "__main__":
    run_app(app, "paper")
