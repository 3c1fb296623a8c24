"""`cablesense gap adapt`: from a recording to an estimator that is corrected by its diagnosis."""

from __future__ import annotations

import shlex
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from cablesense_base.files import output_folder, write_atomically
from cablesense_ros.cli.options import (
    ForceOption,
    JsonOption,
    NominalArmOption,
    OptionError,
    RecordingArgument,
    WorkersOption,
    diagnosis_progress,
    print_json,
)

if TYPE_CHECKING:
    from cablesense_gap.adaptation import Adaptation
    from cablesense_gap.recorded_contacts import RecordedErrors

ADAPTED_MODEL = "estimator.onnx"


def adapt(
    recording: RecordingArgument,
    out: Annotated[
        Path,
        typer.Option(help="Folder for what `gap diagnose` writes, and for estimator.onnx."),
    ],
    arm: NominalArmOption = "cdsm_lab",
    model: Annotated[
        str | None,
        typer.Option(
            help="The estimator in use: a path, or a bundled name.",
            show_default="the bundled one of the arm's name",
        ),
    ] = None,
    workers: WorkersOption = 2,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Diagnose a recording, and train the force estimator on the arm as it is found to be.

    A fifth of the trials are withheld from diagnosis and training; on their loads both
    estimators are judged. Writes what `gap diagnose` writes, with these errors, and the model
    that the estimator node takes; where it is no better than the one in use, this is said, and
    that one is kept.

    Example: [bold]cablesense gap adapt recording.mcap --arm my_arm.yaml --model my_arm.onnx
    --out adapted[/bold]
    """
    from cablesense_gap.adaptation import adapt as make
    from cablesense_gap.amended_arm import AMENDED_ARM
    from cablesense_gap.recordings.checks import read_recording
    from cablesense_gap.report.page import DIAGNOSIS_FILES, write_diagnosis
    from cablesense_gap.report.text import FRICTION_HIDES, headline
    from cablesense_online.misfit_limit import put_simulated_limit
    from cablesense_sim.arm import find_arm, load_arm
    from cablesense_training.errors import TrainingError
    from cablesense_training.inference.metadata import bundled_models, find_model

    arm_file = find_arm(arm)
    nominal = load_arm(arm_file)
    if model is None and nominal.name not in bundled_models():
        raise OptionError(
            f"no model is bundled for arm {nominal.name}: give the one in use with --model, or "
            f"make one with `cablesense train --arm {arm} --out {nominal.name}.onnx`"
        )
    first = find_model(model or nominal.name)
    output_folder(
        out, (*DIAGNOSIS_FILES, ADAPTED_MODEL), force=force, inputs=(recording, arm_file, first)
    )
    recorded = read_recording(recording, nominal)
    command = ["cablesense", "gap", "adapt", recording.name, "--arm", arm, "--out", out.name]
    console = Console(stderr=json_output)
    with tempfile.TemporaryDirectory() as folder, diagnosis_progress(console) as progress:
        second = Path(folder) / ADAPTED_MODEL

        show, warn = progress
        found = make(recorded, nominal, first, second, shlex.join(command), show, workers, warn)
        if found.better:
            put_simulated_limit(second)
        models = {"before": found.before} | ({"after": found.after} if found.after else {})
        write_diagnosis(out, found.diagnosis, models)
        adapted = out / ADAPTED_MODEL
        if found.better:
            write_atomically(adapted, second.read_bytes(), TrainingError)
        else:  # one of an earlier run is for another arm
            adapted.unlink(missing_ok=True)
    if json_output:
        use = adapted if found.better else first
        verdict = found.diagnosis.verdict.model_dump(mode="json", exclude_none=True)
        print_json({"model": str(use), "better": found.better, "verdict": verdict})
        return
    console.print(headline(found.diagnosis.verdict), soft_wrap=True)
    console.print(_outcome(found, first), soft_wrap=True, highlight=False)
    console.print(f"Report: {out / 'report.html'}", soft_wrap=True)
    if "capstan_friction" in found.diagnosis.verdict.effects:
        console.print(FRICTION_HIDES, soft_wrap=True)
    if found.better:
        run = f"ros2 run cablesense_ros estimator --ros-args -p arm:={out / AMENDED_ARM}"
        console.print(f"Run it: {run} -p model:={adapted}", soft_wrap=True)


def _outcome(found: Adaptation, first: Path) -> str:
    """The errors before and after in a sentence, and which model to use."""
    if found.after is None:
        return f"Nothing was found that an estimator could be trained on: keep {first}."
    before, after = (_errors(each) for each in (found.before, found.after))
    trials = len(found.trials)
    errors = (
        f"on {found.before.whole.errors.contacts} loaded rows of {trials} trials that neither "
        f"diagnosis nor training had: {after}; before: {before}"
    )
    if found.better:
        return f"The estimator is corrected, {errors}."
    return f"The second estimator is no better, {errors}. Keep {first}."


def _errors(errors: RecordedErrors) -> str:
    of_loads = errors.whole.errors
    return (
        f"force off by {of_loads.magnitude_mae_n:.2f} N, direction by "
        f"{of_loads.direction_mae_deg:.1f}°, segment right {of_loads.contact_accuracy:.1%}"
    )
