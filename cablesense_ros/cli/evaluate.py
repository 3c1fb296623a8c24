"""`cablesense evaluate`: how good the estimators are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from cablesense_base.files import output_file, write_atomically
from cablesense_contact.felt_arm import FeltArm
from cablesense_ros.cli.options import (
    ColumnsOption,
    ForceOption,
    JsonOption,
    OptionError,
    TopicsOption,
    VerboseOption,
    WorkersOption,
    print_notes,
    print_summary,
    refuse_given,
)
from cablesense_ros.cli.summaries import (
    comparison_lines,
    law_lines,
    network_lines,
    recorded_lines,
    table2_lines,
)
from cablesense_sim.machine.description import is_machine_file

if TYPE_CHECKING:
    from cablesense_contact.felt import FeltMachine
    from cablesense_contact.inference.estimator import Estimator
    from cablesense_contact.inference.law_model import LawModel
    from cablesense_gap.recorded_contacts import KnownLaw
    from cablesense_recording.layout import Described


def evaluate(
    context: typer.Context,
    samples: Annotated[
        int, typer.Option(min=100, max=10_000_000, help="Fresh samples per setting.")
    ] = 20_000,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the samples; none of it was trained on.")
    ] = 20_260_001,
    workers: WorkersOption = 1,
    model: Annotated[
        list[str] | None,
        typer.Option(
            help="Evaluate this model of contacts anywhere, or of a network of one contact (a "
            "path, or a bundled name) alone, on its own arm. With --recording repeatable: before "
            "and after an adaptation."
        ),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(
            help="Instead: the known loads of this recording (.csv, .mcap, rosbag2 folder), of "
            "the model's arm, or of the machine of --arm."
        ),
    ] = None,
    arm: Annotated[
        str,
        typer.Option(
            help="With --recording: the machine file of a machine that MuJoCo describes, whose "
            "model lies beside it unless --model names it.",
            show_default="the model's own arm",
        ),
    ] = "",
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="With --recording: how well the arm is known, as a commissioning has written "
            "it; without it, the recording's unloaded rows say so."
        ),
    ] = None,
    columns: ColumnsOption = None,
    topic: TopicsOption = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="With --recording: also draw estimated against true forces, .png."),
    ] = None,
    force: ForceOption = False,
    table2: Annotated[
        bool,
        typer.Option(
            "--table2", help="Instead: the paper's measured tensions, true load against estimate."
        ),
    ] = False,
    verbose: VerboseOption = False,
    json_output: JsonOption = False,
) -> None:
    """Compare the estimator, the paper's networks and the noise bound on fresh samples.

    Without options: single contacts on the straight arm, at random poses, and on a compliant arm;
    several contacts at once. With [bold]--model[/bold] of contacts anywhere: statements on arms
    as a workshop builds them by the file, and on exactly the arm of the file. With
    [bold]--table2[/bold]: the six loads that were hung on the physical arm. With
    [bold]--recording[/bold]: a model on one's own arm, by segment and by force.

    Examples: [bold]cablesense evaluate --json[/bold], [bold]cablesense evaluate --table2[/bold],
    [bold]cablesense evaluate --model my_arm.onnx[/bold],
    [bold]cablesense evaluate --recording loads.mcap --model my_arm.onnx[/bold],
    [bold]cablesense evaluate --recording loads.mcap --arm my_finger.yaml[/bold]
    """
    models = model or []
    if recording is None:
        of_recordings = ("picture", "force", "calibration", "columns", "topic", "arm")
        refuse_given(context, of_recordings, "without --recording")
        if len(models) > 1:
            raise OptionError("several --model go with --recording alone; give one")
    if recording is not None:
        drawn = ("samples", "seed", "workers", "table2")
        refuse_given(context, drawn, "with --recording, which draws no samples")
        if arm and not is_machine_file(arm):
            raise OptionError(
                f"--arm {arm}: no machine file; a model knows its own arm, so give --model"
            )
        if not models and not arm:
            raise OptionError("--recording needs --model, the model that is to be judged on it")
        if picture is None:
            refuse_given(context, ["force"], "without --picture")
        else:
            output_file(picture, force=force, inputs=(recording, *models))
        judged = [_judged(name, arm) for name in models or [""]]
        title, content, notes = _recorded(
            recording, judged, calibration, picture, topic or (), columns
        )
        print_notes(notes, json_output)
        lines = recorded_lines(content, judged[0].machine.link_names)
    elif table2:
        unused = ("samples", "seed", "workers")
        refuse_given(context, unused, "with --table2, which draws no samples")
        title, content = _table2("".join(models))
        lines = table2_lines(content)
    elif models:
        title, content = _one_model(models[0], samples, seed, workers)
        lines = law_lines(content) if "as_the_file" in content else network_lines(content)
    else:
        title, content = _comparison(samples, seed, workers)
        lines = comparison_lines(content)
    print_summary(title, lines, content, as_json=json_output, verbose=verbose)


Result = tuple[str, dict[str, Any]]
"""A title, and figures as plain values."""


def _table2(model: str) -> Result:
    from cablesense_contact.inference.metadata import find_model
    from cablesense_contact.inference.single_contact import open_estimator
    from cablesense_training.evaluation.comparison import (
        DOWN_DEG,
        SHIPPED,
        TABLE2_MODELS,
        evaluate_table2,
    )

    opened = open_estimator(find_model(model or TABLE2_MODELS[SHIPPED]))
    content = [
        {
            "true_segment": row.load.segment,
            "segment": row.segment,
            "true_angle_deg": DOWN_DEG,
            "angle_deg": row.angle_deg,
            "true_magnitude_n": row.load.weight_n,
            "magnitude_n": row.magnitude_n,
            "magnitude_error": row.magnitude_n / row.load.weight_n - 1.0,
            "magnitude_ci95_n": [row.low_n, row.high_n],
        }
        for row in evaluate_table2(opened)
    ]
    title = "Loads hung on the physical arm (the paper's Table II)"
    return title, {"model": opened.metadata.network, "rows": content}


class Judged(NamedTuple):
    """A model that is to be judged on a recording.

    Attributes:
        name: of the model, as given.
        estimator: opened.
        machine: that it is for.
        described: what recordings of that are read by.
    """

    name: str
    estimator: KnownLaw | Estimator
    machine: FeltMachine
    described: Described


def _judged(model: str, arm: str) -> Judged:
    """A model by its name or path, of an arm or of the machine of a file."""
    if arm:
        from cablesense_online.machine_models import load_machine

        loaded = load_machine(arm, model)
        return Judged(loaded.path, loaded.law, loaded.machine, loaded.described)
    from cablesense_contact.inference.metadata import find_model
    from cablesense_contact.inference.single_contact import open_estimator

    estimator = open_estimator(find_model(model))
    own_arm = estimator.metadata.arm
    return Judged(model, estimator, FeltArm(own_arm), own_arm)


def _recorded(
    recording: Path,
    judged: Sequence[Judged],
    calibration: Path | None,
    picture: Path | None,
    topics: Sequence[str],
    columns: Path | None,
) -> tuple[str, dict[str, Any], tuple[str, ...]]:
    """Title and figures, and what was read of the recording, as sentences."""
    from cablesense_contact.calibration_file import prior_notes, read_calibration
    from cablesense_contact.unloaded_holds import with_held_positions
    from cablesense_gap.recorded_contacts import recorded_errors
    from cablesense_gap.report.page import drawn_errors
    from cablesense_gap.report.style import image_bytes, style
    from cablesense_recording.column_map import read_column_map
    from cablesense_recording.reading import read_recording

    errors = {}
    notes: tuple[str, ...] = ()
    for one in judged:
        known = None if calibration is None else read_calibration(calibration, one.machine)
        named = None if columns is None else read_column_map(columns, one.described).with_loads
        recorded = read_recording(recording, one.described, topics, named)
        notes = (*recorded.notes, *prior_notes(known, one.machine, str(calibration)))
        if one.machine.reads_joints:
            recorded = with_held_positions(recorded)
        errors[one.name] = recorded_errors(recorded, one.estimator, calibration=known)
    if picture is not None:
        with style():
            image = image_bytes(drawn_errors(errors), "png")
        write_atomically(picture, image, OptionError)
    figures = {name: each.as_json() for name, each in errors.items()}
    return f"Known loads of {recording.name}", figures, notes


def _one_model(model: str, samples: int, seed: int, workers: int) -> Result:
    """A model on fresh samples: of the law's arm, or like those of a network's training."""
    from cablesense_contact.inference.law_model import LawModel
    from cablesense_contact.inference.metadata import find_model
    from cablesense_contact.inference.single_contact import open_estimator

    opened = open_estimator(find_model(model))
    described = opened.metadata
    title = f"{described.network} on {described.arm_identity}, {samples} fresh samples"
    if isinstance(opened, LawModel):
        return title, _law_statements(opened, samples, seed)
    return title, _network_errors(opened, samples, seed, workers)


def _network_errors(estimator: Estimator, samples: int, seed: int, workers: int) -> dict[str, Any]:
    """A network's errors on samples like those of its training, next to their noise bound."""
    from cablesense_training.data.generation import draw_dataset
    from cablesense_training.data.protocols import SingleContact
    from cablesense_training.evaluation.comparison import evaluate_estimator, metrics_json
    from cablesense_training.evaluation.metrics import noise_bound

    described = estimator.metadata
    protocol = SingleContact(
        samples=samples,
        pose="random" if described.pose_range_deg > 0 else "straight",
        pose_range_deg=described.pose_range_deg,
        force_high_n=described.force_range_n,
        tare_samples=described.tare_samples,
    )
    dataset = draw_dataset(described.arm, protocol, seed, workers=workers)
    metrics = evaluate_estimator(estimator, dataset).metrics
    return {"single": metrics_json(metrics), "bound": asdict(noise_bound(dataset))}


def _law_statements(law: LawModel, samples: int, seed: int) -> dict[str, Any]:
    """What a law states, on arms of the tolerances of its file and on exactly that of the file."""
    from cablesense_base.progress import progress_bar
    from cablesense_training.evaluation.law import evaluate_built, evaluate_exact, law_protocol

    protocol = law_protocol(law.arm, samples)
    with progress_bar(samples) as advance:
        built = evaluate_built(law, law.arm, protocol, seed, advance)
    exact = evaluate_exact(law, law.arm, protocol, seed)
    force_range_n = [protocol.force_low_n, protocol.force_high_n]
    return {
        "force_range_n": force_range_n,
        "built_by_tolerances": built.as_json(),
        "as_the_file": exact.as_json(),
    }


def _comparison(samples: int, seed: int, workers: int) -> Result:
    from cablesense_base.progress import status
    from cablesense_training.evaluation.comparison import compare

    with status("Evaluating …") as say:
        content = compare(seed, samples, workers, lambda name: say(f"Evaluating {name} …"))
    return "The estimator, the paper's networks, and the noise bound", content
