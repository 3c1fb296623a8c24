"""`cablesense gap …`: a recording of the real arm, or another robot, against its simulation."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console

from cablesense_base import CableSenseError
from cablesense_base.files import output_file, output_folder, write_atomically
from cablesense_base.progress import StagedProgress, staged_progress, status
from cablesense_ros.cli.gap_recordings import protocol, record, score, watch
from cablesense_ros.cli.options import (
    ColumnsOption,
    EffortOption,
    ForceOption,
    JsonOption,
    ModelOption,
    NominalArmOption,
    OptionError,
    RecordingArgument,
    TopicsOption,
    WorkersOption,
    print_json,
    refuse_given,
)
from cablesense_ros.cli.resumable import resumable

if TYPE_CHECKING:
    from cablesense_gap.adaptation import Adaptation, AdaptedEstimator
    from cablesense_gap.recorded_contacts import RecordedErrors
    from cablesense_gap.report.next_step import NextStep

BandwidthOption = Annotated[
    float | None,
    typer.Option(
        help="With --model: hertz up to which motion and torques are compared.",
        show_default="as wide as noise lets it be",
    ),
]
ForwardOption = Annotated[
    bool | None,
    typer.Option(
        "--forward/--inverse",
        help="With --model: compare motion, forward in time over short windows, or the torques "
        "that motion needs.",
        show_default="forward where commands and no torques are recorded",
    ),
]
ForcedDiagnosisOption = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Replace files of the same names that exist already, and diagnose a recording whose "
        "columns look exchanged or reversed.",
    ),
]
ZeroedOption = Annotated[
    bool,
    typer.Option(
        "--zeroed",
        help="With --model: encoders were set to zero where each trial begins, wherever that was.",
    ),
]
ReferenceOption = Annotated[
    Path | None,
    typer.Option(
        help="A recording of the same machine when healthy: the verdict is what changed since."
    ),
]
PositionsOption = Annotated[
    Literal["drive", "external"],
    typer.Option(
        help="With --model: positions are those of the drives' encoders, or were measured outside "
        "the drives, as by a camera, and are compared with the commands of position servos."
    ),
]
OF_ROBOTS = ("bandwidth", "forward", "zeroed", "positions", "effort")
_SHOWN_N = 0.05
"""Unexplained readings from this on are stated."""


def diagnose(
    context: typer.Context,
    recording: RecordingArgument,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for verdict.json, report.html, and amended_arm.yaml, or with --model "
            "amended_model.xml and amended_model.json."
        ),
    ],
    arm: NominalArmOption = "cdsm_lab",
    model: ModelOption = None,
    bandwidth: BandwidthOption = None,
    forward: ForwardOption = None,
    zeroed: ZeroedOption = False,
    positions: PositionsOption = "drive",
    topic: TopicsOption = None,
    columns: ColumnsOption = None,
    effort: EffortOption = None,
    reference: ReferenceOption = None,
    workers: WorkersOption = 2,
    force: ForcedDiagnosisOption = False,
    json_output: JsonOption = False,
) -> None:
    """Find where the gap lies, which effect causes it, and how far it shrinks with that effect.

    Writes the verdict, a report to read, and an amended arm file that the sim, the training and
    `gap predict` take as they take any other. For another robot, give its --model; the recording
    then has columns position.<joint>, and torque.<joint> or command.<actuator>, and the model is
    amended.

    Examples: [bold]cablesense gap diagnose recording.csv --arm my_arm.yaml --out diagnosis[/bold],
    [bold]cablesense gap diagnose recording.csv --model robot.xml --out diagnosis[/bold]
    """
    console = Console(stderr=json_output)
    if model is None:
        refuse_given(context, OF_ROBOTS, "without --model")
        verdict, lines = _diagnosed_arm(
            recording, out, arm, reference, workers, force, console, topic or (), columns
        )
    else:
        from cablesense_gap.report.next_step import Given, robot_next_step
        from cablesense_gap.report.page import write_robot_diagnosis
        from cablesense_gap.report.text import (
            coverage_sentence,
            earlier_sentence,
            headline,
            size_lines,
        )
        from cablesense_gap.robot.amending import ROBOT_FILES, load_amended
        from cablesense_gap.robot.recording import read_robot_recording
        from cablesense_gap.robot.system import diagnose as make

        refuse_given(context, ["arm", "columns"], "with --model")
        _refuse_forward(context, positions)
        robot, beside = load_amended(model)
        output_folder(out, ROBOT_FILES, force=force, inputs=(recording, robot.path))
        read = partial(
            read_robot_recording,
            robot=robot,
            topics=topic or (),
            efforts=effort or (),
            force=force,
        )
        inputs = [path for path in (recording, robot.path, reference) if path]
        settings = [bandwidth, forward, zeroed, positions, topic, effort, sorted(beside.items())]
        with resumable(out, inputs, settings, console) as kept, _diagnosis_progress() as progress:
            recorded = read(recording)
            healthy = None if reference is None else read(reference)
            said = (*recorded.notes, *recorded.warnings)
            of_reference = () if healthy is None else (*healthy.notes, *healthy.warnings)
            # before the minutes that a fit may take
            for sentence in (*said, *(f"Reference: {each}" for each in of_reference)):
                console.print(sentence, soft_wrap=True, markup=False, highlight=False)
            diagnosis = make(
                recorded,
                robot,
                beside,
                bandwidth,
                progress.show,
                workers,
                forward,
                zeroed=zeroed,
                external=positions == "external",
                force=force,
                reference=healthy,
                announce=progress.announce,
                kept=kept,
            )
        given = Given(str(recording), str(model), str(out), external=positions == "external")
        write_robot_diagnosis(out, diagnosis, given)
        verdict = diagnosis.verdict
        sentences = (*diagnosis.warnings, *diagnosis.notes)
        more = [sentence for sentence in sentences if sentence not in said]
        earlier = [earlier_sentence(each, of_robot=True) for each in verdict.earlier]
        lines = [*more, headline(verdict), *size_lines(verdict), *earlier]
        lines += [line for line in (coverage_sentence(verdict), *verdict.doubts) if line]
        lines.append(_next(robot_next_step(verdict, given)))
    if json_output:
        print_json(verdict.model_dump(mode="json", exclude_none=True))
        return
    for line in (*lines, f"Report: {out / 'report.html'}"):
        console.print(line, soft_wrap=True, markup=False, highlight=False)


def _next(step: NextStep) -> str:
    return f"Next: {step.title.lower()}: {step.command}"


def _diagnosis_progress() -> AbstractContextManager[StagedProgress]:
    from cablesense_gap.diagnosis.duration import STAGES

    return staged_progress(STAGES)


def _refuse_forward(context: typer.Context, positions: str) -> None:
    if positions == "external":
        refuse_given(context, ["forward"], "with --positions external")


def _diagnosed_arm(
    recording: Path,
    out: Path,
    arm: str,
    reference: Path | None,
    workers: int,
    force: bool,
    console: Console,
    topics: Sequence[str],
    columns: Path | None,
) -> tuple[Any, list[str]]:
    """The verdict, and lines for people."""
    from cablesense_gap.arm_system import diagnose as make
    from cablesense_gap.report.next_step import Given, next_step
    from cablesense_gap.report.page import DIAGNOSIS_FILES, write_diagnosis
    from cablesense_gap.report.text import (
        coverage_sentence,
        earlier_sentence,
        headline,
        size_lines,
    )
    from cablesense_recording.column_map import read_column_map
    from cablesense_recording.reading import read_recording
    from cablesense_sim.arm import find_arm, load_arm

    arm_file = find_arm(arm)
    output_folder(out, DIAGNOSIS_FILES, force=force, inputs=(recording, arm_file))
    nominal = load_arm(arm_file)
    meant = None if columns is None else read_column_map(columns, nominal).with_loads
    read = partial(read_recording, arm=nominal, topics=topics, columns=meant)
    recorded = read(recording)
    healthy = None if reference is None else read(reference)
    inputs = [path for path in (recording, arm_file, reference, columns) if path]
    with (
        resumable(out, inputs, ["diagnose", topics], console) as kept,
        _diagnosis_progress() as progress,
    ):
        diagnosis = make(
            recorded,
            nominal,
            progress.show,
            workers,
            progress.warn,
            reference=healthy,
            force=force,
            announce=progress.announce,
            kept=kept,
        )
    given = Given(str(recording), arm, str(out))
    write_diagnosis(out, diagnosis, given=given)
    lines = [*recorded.notes, headline(diagnosis.verdict), *size_lines(diagnosis.verdict)]
    lines += [line for line in (coverage_sentence(diagnosis.verdict),) if line]
    lines += [*map(earlier_sentence, diagnosis.verdict.earlier)]
    if len(diagnosis.recording) < len(recorded):
        lines.append(f"Used: {len(diagnosis.recording):,} of {len(recorded):,} rows")
    lines.append(_next(next_step(diagnosis.verdict, given)))
    return diagnosis.verdict, lines


def predict(
    context: typer.Context,
    recording: RecordingArgument,
    out: Annotated[Path, typer.Option(help="CSV file for the recording's rows as predicted.")],
    arm: Annotated[
        str,
        typer.Option(
            help="Arm, amended or nominal: a path, the folder of a diagnosis, or the name of a "
            "bundled one."
        ),
    ] = "cdsm_lab",
    model: ModelOption = None,
    bandwidth: BandwidthOption = None,
    forward: ForwardOption = None,
    zeroed: ZeroedOption = False,
    positions: PositionsOption = "drive",
    topic: TopicsOption = None,
    effort: EffortOption = None,
    settle: Annotated[
        int,
        typer.Option(
            min=0,
            help="Estimate the initial state from this many first rows: plays, friction states, "
            "creep, zeros that drift.",
        ),
    ] = 0,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Predict what a recording measured, without noise, by an arm or a robot.

    An arm's tensions follow from its commands and loads alone. With --settle the first rows are
    read too, since friction and creep depend on the past. With --model, a robot's torques follow
    from its motion, or its motion from its commands.

    Example: [bold]cablesense gap predict new.csv --arm diagnosis --out new_predicted.csv[/bold]
    """
    console = Console(stderr=json_output)
    if model is None:
        refuse_given(context, OF_ROBOTS, "without --model")
        figures, lines = _predicted_arm(recording, out, arm, settle, force, console, topic or ())
    else:
        from cablesense_gap.robot.amending import load_amended
        from cablesense_gap.robot.preparation import prepared
        from cablesense_gap.robot.recording import read_robot_recording
        from cablesense_gap.robot.system import RobotSystem, write_prediction

        refuse_given(context, ["arm", "settle"], "with --model")
        _refuse_forward(context, positions)
        robot, beside = load_amended(model)
        output_file(out, force=force, inputs=(recording, robot.path))
        recorded = read_robot_recording(recording, robot, topic or (), efforts=effort or ())
        external = positions == "external"
        motion = prepared(recorded, robot, bandwidth, forward, zeroed=zeroed, external=external)
        system = RobotSystem(robot, motion, beside)
        write_prediction(out, system)
        gaps = system.gaps()
        figures = {
            "rows": system.recorded_row_count,
            "gap": {name: gap for name, _, gap, _ in gaps},
        }
        sizes = ", ".join(
            f"{name} {gap:.3g} of {size:.3g} {unit}" for name, unit, gap, size in gaps
        )
        lines = [
            f"{system.compared} Gap, of the measured values (RMS): {sizes}",
            *recorded.notes,
            *recorded.warnings,
        ]
    if json_output:
        print_json({"out": str(out), **figures})
        return
    first, *others = lines
    for line in (f"{out}: {first}", *others):
        console.print(line, soft_wrap=True, markup=False)


def _predicted_arm(
    recording: Path,
    out: Path,
    arm: str,
    settle: int,
    force: bool,
    console: Console,
    topics: Sequence[str],
) -> tuple[dict[str, Any], list[str]]:
    """Figures, and lines for people."""
    from cablesense_gap.amended_arm import find_amended
    from cablesense_gap.arm_simulator import counted_rows, settled
    from cablesense_recording.csv_file import write_csv
    from cablesense_recording.reading import read_recording
    from cablesense_sim.arm import load_arm
    from cablesense_sim.replay import replay_arm

    arm_file = find_amended(arm)
    output_file(out, force=force, inputs=(recording, arm_file))
    described = load_arm(arm_file)
    recorded = read_recording(recording, described, topics)
    rows = len(recorded)
    if settle >= rows:
        raise CableSenseError(
            f"--settle {settle}: {recording} has {rows} rows; leave some to predict"
        )
    with status("predicting"):
        described = settled(described, recorded, settle)
        tensions_n = replay_arm(described, recorded.course)
    write_csv(out, replace(recorded, tensions_n=tensions_n))
    counted = counted_rows(described, recorded, tensions_n)
    counted[:settle] = False
    judged = int(counted.sum())
    difference_n = (recorded.tensions_n - tensions_n)[counted]
    gap_n = float((difference_n**2).mean() ** 0.5) if judged else None
    size = "no row counts" if gap_n is None else f"{gap_n:.3f} N (RMS) from the readings"
    lines = [f"{rows} rows, {size}", *recorded.notes]
    if settle:
        lines.append(f"Not counted: the first {settle}, that the state was estimated from")
    if other := rows - settle - judged:
        lines.append(
            f"Not counted: {other} rows, where the arm has several rests or is about to turn"
        )
    return {"rows": rows, "settled": settle, "rows_counted": judged, "gap_n": gap_n}, lines


def adapt(
    recording: RecordingArgument,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for what `gap diagnose` writes, for estimator.onnx and calibration.npz."
        ),
    ],
    arm: NominalArmOption = "cdsm_lab",
    model: Annotated[
        str | None,
        typer.Option(
            help="The estimator in use, of single contacts: a path, or a bundled name.",
            show_default="that of the arm file",
        ),
    ] = None,
    topic: TopicsOption = None,
    workers: WorkersOption = 2,
    force: ForcedDiagnosisOption = False,
    json_output: JsonOption = False,
) -> None:
    """Diagnose a recording, and make the force estimator of the arm as it is found to be.

    A fifth of the trials are withheld from the diagnosis; on their loads both estimators are
    judged. Writes what `gap diagnose` writes, with these errors, the model that the estimator node
    takes, and its calibration, and says which of the two to use.

    Example: [bold]cablesense gap adapt recording.mcap --arm my_arm.yaml --out adapted[/bold]
    """
    from cablesense_contact.calibration_file import write_calibration
    from cablesense_contact.inference.metadata import find_model
    from cablesense_contact.inference.single_contact import open_estimator
    from cablesense_gap.adaptation import adapt as make
    from cablesense_gap.adaptation import exported
    from cablesense_gap.report.next_step import ADAPTED_MODEL, CALIBRATION, Given, next_step
    from cablesense_gap.report.page import DIAGNOSIS_FILES, write_diagnosis
    from cablesense_gap.report.text import FRICTION_HIDES, headline
    from cablesense_recording.reading import read_recording
    from cablesense_sim.arm import find_arm, load_arm

    arm_file = find_arm(arm)
    nominal = load_arm(arm_file)
    path = find_model(model) if model else None
    first = open_estimator(path, nominal) if path else None
    written = (*DIAGNOSIS_FILES, ADAPTED_MODEL, CALIBRATION)
    inputs = (recording, arm_file, path) if path else (recording, arm_file)
    output_folder(out, written, force=force, inputs=inputs)
    recorded = read_recording(recording, nominal, topic or ())
    words = ["cablesense", "gap", "adapt", recording.name, "--arm", arm, "--out", out.name]
    console = Console(stderr=json_output)
    adapted_model = out / ADAPTED_MODEL
    calibration = out / CALIBRATION
    with (
        resumable(out, (recording, arm_file), ["adapt", topic], console) as kept,
        tempfile.TemporaryDirectory() as folder,
        _diagnosis_progress() as progress,
    ):
        adaptation = make(
            recorded,
            nominal,
            first,
            progress.show,
            workers,
            progress.warn,
            force=force,
            announce=progress.announce,
            kept=kept,
        )
        exported_model = Path(folder) / ADAPTED_MODEL
        attempt = exported(adaptation, exported_model, shlex.join(words))
        adaptation = attempt.adaptation
        made = adaptation.adapted
        models = {"before": adaptation.before} | (
            {"after": adaptation.after} if adaptation.after else {}
        )
        given = Given(str(recording), arm, str(out), model or "")
        write_diagnosis(out, adaptation.diagnosis, models, given)
        if made is not None:
            write_atomically(adapted_model, exported_model.read_bytes(), OptionError)
            write_calibration(calibration, made.calibration)
        else:  # those of an earlier run are for another arm
            adapted_model.unlink(missing_ok=True)
            calibration.unlink(missing_ok=True)
    verdict = adaptation.diagnosis.verdict
    if json_output:
        used = adapted_model if adaptation.better else path
        print_json(
            {
                "model": str(used) if used else None,
                "calibration": str(calibration) if adaptation.better else None,
                "made": str(adapted_model) if made else None,
                "better": adaptation.better,
                "verdict": verdict.model_dump(mode="json"),
            }
        )
        return
    in_use = str(path) if path else f"the estimator of {nominal.name}"
    lines = [
        *recorded.notes,
        headline(verdict),
        _outcome(adaptation, in_use),
        *([f"No new estimator: {attempt.refusal}"] if attempt.refusal else []),
        f"Report: {out / 'report.html'}",
    ]
    if "capstan_friction" in verdict.effects:
        lines.append(FRICTION_HIDES)
    if made is not None and not adaptation.better:
        lines.append(f"The new one is kept: {adapted_model}, {calibration}")
    if made is not None and adaptation.better:
        lines += _noise(made)
    lines.append(_next(next_step(verdict, given)))
    for line in lines:
        console.print(line, soft_wrap=True, highlight=False)


def _noise(made: AdaptedEstimator) -> list[str]:
    """What the new estimator takes as noise, if it is much."""
    if made.unexplained_n < _SHOWN_N:
        return []
    return [
        f"Readings differ by {made.unexplained_n:.2f} N (RMS) from what this arm explains, beyond "
        "the sensors' noise: the estimator takes it as noise, so its intervals are wider."
    ]


def _outcome(found: Adaptation, kept: str) -> str:
    """The errors before and after in a sentence, and which model to use."""
    if found.after is None:
        return f"Nothing was found that would make another estimator: keep {kept}."
    before, after = map(_errors, (found.before, found.after))
    use = "Use the new estimator." if found.better else f"The new one is no better: keep {kept}."
    return (
        f"On {found.before.whole.errors.contacts} loaded rows of {len(found.trials)} trials that "
        f"the diagnosis did not have: before, {before}; after, {after}. Force stated wrongly or "
        f"missed decides: {found.before.wrong_n:.2f} N before, {found.after.wrong_n:.2f} N after. "
        f"{use}"
    )


def _errors(judged: RecordedErrors) -> str:
    errors = judged.whole.errors
    parts = [f"force off by {errors.magnitude_mae_n:.2f} N"]
    if errors.found:
        parts.append(f"direction by {errors.direction_mae_deg:.1f}°")
    parts.append(f"segment right {errors.contact_accuracy:.1%}")
    return ", ".join(parts)


gap = typer.Typer(
    name="gap",
    help="Diagnoses the gap between a recorded arm and the simulated one: where it lies, "
    "which effect causes it, how far it shrinks once that effect is simulated.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)
for verb in (diagnose, adapt, predict, protocol, record, score, watch):
    gap.command()(verb)
