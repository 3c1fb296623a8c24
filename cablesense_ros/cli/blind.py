"""`cablesense gap withhold` and `score`: recordings of hidden things, verdicts against answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from glob import escape
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from cablesense_base.files import output_folder
from cablesense_ros.cli.gap_robot import ModelOption
from cablesense_ros.cli.options import (
    ForceOption,
    JsonOption,
    NominalArmOption,
    WorkersOption,
    print_json,
    refuse_given,
    titled_table,
)

if TYPE_CHECKING:
    from cablesense_gap.scoring import ScoreSheet
    from cablesense_gap.verdict import Verdict


def score(
    context: typer.Context,
    verdicts: Annotated[
        Path,
        typer.Argument(
            metavar="DIR_OF_VERDICTS",
            help="Holds RECORDING/verdict.json, or RECORDING.json, for each row of the answers.",
        ),
    ],
    answers: Annotated[
        Path, typer.Option(help="CSV with recording, effects joined by +, and where.")
    ],
    second: Annotated[
        Path | None,
        typer.Option(
            help="Folder with a second recording of each arm, RECORDING.csv: also score how much "
            "of the gap RECORDING/amended_arm.yaml removes there."
        ),
    ] = None,
    settle: Annotated[
        int,
        typer.Option(
            min=0,
            help="With --second: estimate the initial state from this many first rows; "
            "they do not count.",
        ),
    ] = 0,
    arm: NominalArmOption = "cdsm_lab",
    json_output: JsonOption = False,
) -> None:
    """Score verdicts against answers: correct names, probabilities, calibration.

    Examples: [bold]cablesense gap score verdicts --answers answers.csv --json[/bold],
    [bold]cablesense gap score verdicts --answers answers.csv --second again --settle 60[/bold]
    """
    from cablesense_gap.scoring import as_json, read_answers, read_verdicts
    from cablesense_gap.scoring import score as score_verdicts

    if second is None:
        refuse_given(context, ("settle", "arm"), "without --second")
    listed = read_answers(answers)
    read = read_verdicts(verdicts, [a.recording for a in listed])
    found = score_verdicts(read, listed)
    removed: dict[str, float] = {}
    if second is not None:
        with Console(stderr=True).status("predicting second recordings"):
            removed = _removed(read, verdicts, second, arm, settle)
    if json_output:
        again = {"settled": settle, "removed_fractions": removed} if removed else None
        print_json(as_json(found) | ({"second_recording": again} if again else {}))
        return
    _print_score(found, Console())
    if removed:
        rows = [(name, f"{share:.1%}") for name, share in removed.items()]
        rows.append(("median", f"{median(removed.values()):.1%}"))
        title = "gap removed on second recordings"
        Console().print(titled_table(title, "recording", "share", right=["share"], rows=rows))
        settled = f"Not counted: the first {settle} rows, which the state was estimated from."
        Console().print(settled if settle else "Counted from the first row on.", highlight=False)


def _removed(
    read: Mapping[str, Verdict], verdicts: Path, second: Path, arm: str, settle: int
) -> dict[str, float]:
    """Share of the gap that each amended arm removes on the recording of its name in a folder."""
    from cablesense_gap.amended_arm import find_amended
    from cablesense_gap.arm_simulator import removed_on
    from cablesense_gap.recordings.checks import read_recording
    from cablesense_sim.arm import load_arm, open_arm

    nominal = open_arm(arm)
    return {
        name: removed_on(
            read_recording(second / f"{name}.csv", nominal),
            nominal,
            load_arm(find_amended(str(verdicts / name))),
            settle,
            verdict.gap.floor_n,
        )
        for name, verdict in read.items()
    }


_SHARES = {
    "exact": "exact",
    "truth among the two most probable": "top2",
    "truth named or in the ambiguity group": "truth_in_group",
    "one effect: exact": "singles_exact",
    "one effect, gap at least 5 floors: exact": "clear_singles_exact",
    "two effects: both named": "doubles_both",
    "two effects: at least one named": "doubles_one",
    "none: false alarms": "false_alarms",
    "unknown: recognised": "unknown_recall",
    "right places, of correct verdicts": "where",
}


def _print_score(found: ScoreSheet, console: Console) -> None:
    headings = ("statistic", "value", "95 % interval", "cases")
    table = titled_table(f"{found.cases} verdicts", *headings)
    shares = {name: getattr(found, field) for name, field in _SHARES.items()}
    shares |= {
        "effects of at least 5 floors: named": found.budgets.named,
        "names given that are false": found.budgets.false_names,
        "shares within a third of the truth": found.budgets.shares,
    }
    shares |= {f"exact, {effect}": share for effect, share in found.by_effect.items()}
    for name, share in shares.items():
        if share.value is None:
            table.add_row(name, "–", "", "0")
            continue
        low, high = share.ci95
        interval, cases = f"{low:.0%} to {high:.0%}", f"{share.hits} of {share.count}"
        table.add_row(name, f"{share.value:.1%}", interval, cases)
    for name, value in (
        ("removable gap removed, median of correct verdicts", found.median_removed_fraction),
        ("mean probability on the truth", found.mean_probability_on_truth),
        ("Brier score of the verdicts", found.reliability.brier),
        ("expected calibration error", found.reliability.expected_error),
    ):
        table.add_row(name, "–" if value is None else f"{value:.3f}", "", str(found.cases))
    console.print(table)
    confusion = titled_table("confusion", "truth", "verdicts")
    for truth, named in found.confusion.items():
        counts = sorted(named.items(), key=lambda pair: (pair[0] != truth, -pair[1], pair[0]))
        confusion.add_row(truth, ", ".join(f"{count} × {name}" for name, count in counts))
    console.print(confusion)


def withhold(
    context: typer.Context,
    count: Annotated[int, typer.Option(min=1, max=10_000, help="How many recordings.")],
    out: Annotated[Path, typer.Option(help="Folder for case_001.csv ….")],
    seed: Annotated[int, typer.Option(min=0, help="The same seed makes the same files.")] = 0,
    arm: NominalArmOption = "cdsm_lab",
    model: ModelOption = None,
    answers: Annotated[
        Path | None, typer.Option(help="File for the answers, if not OUT/answers/answers.csv.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="Hide only this: none, unknown, an effect's name, or several joined by +. "
            "Repeatable; they come in turn."
        ),
    ] = None,
    second: Annotated[
        bool,
        typer.Option("--second", help="Record every arm twice, the second time in OUT/second/."),
    ] = False,
    workers: WorkersOption = 1,
    force: ForceOption = False,
) -> None:
    """Make recordings of arms in which something is hidden, or nothing, and a file of answers.

    The arms come from a plant that shares no code with the simulator or the diagnosis. Every arm
    has manufacturing tolerances; a fifth hides nothing more, a fifth something that no verdict
    has a name for, some two effects at once.

    Examples: [bold]cablesense gap withhold --count 60 --seed 7 --out cases[/bold],
    [bold]cablesense gap withhold --count 10 --only payload --out payloads[/bold]
    """
    from rich.progress import track

    answers_file, kinds = answers or out / "answers" / "answers.csv", tuple(only or ())
    if model is not None:
        refuse_given(context, ["arm", "second", "workers"], "with --model")
        source = model
    else:
        from cablesense_sim.arm import find_arm

        source = find_arm(arm)
    written = ("case_*.csv", "second/case_*.csv") if second else ("case_*.csv",)
    output_folder(out, written, force=force, inputs=(source,))
    output_folder(answers_file.parent, (escape(answers_file.name),), force=force, inputs=(source,))
    made: Iterator[Any]
    if model is not None:
        from cablesense_gap.robot.amending import load_amended
        from cablesense_gap.robot.withholding import withhold as withhold_robots

        robot, _ = load_amended(model)
        for folder in (out, answers_file.parent):
            folder.mkdir(parents=True, exist_ok=True)
        made = withhold_robots(out, answers_file, robot, count, seed, kinds)
    else:
        from cablesense_plants.arm.body import read_nominal
        from cablesense_plants.arm.withhold import withhold as withhold_arms

        nominal = read_nominal(source)
        made = withhold_arms(
            out, answers_file, nominal, count, seed, kinds, workers, second=second
        )
    console = Console()
    for _ in track(made, description="Recording", total=count, console=console):
        pass
    console.print(f"{count} recordings in {out}, the answers in {answers_file}", soft_wrap=True)
