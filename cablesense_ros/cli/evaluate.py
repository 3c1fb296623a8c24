"""`cablesense evaluate`: how good the estimators are, on fresh samples or measured ones."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from cablesense_base.files import output_file, write_atomically
from cablesense_ros.cli.options import (
    ERRORS,
    ForceOption,
    JsonOption,
    OptionError,
    WorkersOption,
    error_cells,
    print_json,
    refuse_given,
    titled_table,
)

if TYPE_CHECKING:
    from cablesense_training.evaluation.metrics import SingleContactMetrics
    from cablesense_training.evaluation.noise_bound import NoiseBound


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
            help="Evaluate this single-contact model (a path, or a bundled name) alone, "
            "on its own arm. With --recording repeatable: before and after an adaptation."
        ),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(
            help="Instead: the known loads of this recording (.csv, .mcap, rosbag2 folder), of "
            "the model's arm."
        ),
    ] = None,
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
    json_output: JsonOption = False,
) -> None:
    """Compare the bundled models, their baselines and the noise bound on fresh samples.

    Without options: single contacts on the straight arm, at random poses, on a compliant arm, and
    from tensions alone; several contacts at once. With [bold]--table2[/bold]: the six loads that
    were hung on the physical arm. With [bold]--recording[/bold]: a model on one's own arm, by
    segment and by force.

    Examples: [bold]cablesense evaluate --json[/bold], [bold]cablesense evaluate --table2[/bold],
    [bold]cablesense evaluate --model my_arm.onnx[/bold],
    [bold]cablesense evaluate --recording loads.mcap --model my_arm.onnx[/bold]
    """
    models = model or []
    if recording is None:
        refuse_given(context, ("picture", "force"), "without --recording")
        if len(models) > 1:
            raise OptionError("several --model go with --recording alone; give one")
    if recording is not None:
        drawn = ("samples", "seed", "workers", "table2")
        refuse_given(context, drawn, "with --recording, which draws no samples")
        if not models:
            raise OptionError("--recording needs --model, the model that is to be judged on it")
        if picture is None:
            refuse_given(context, ["force"], "without --picture")
        else:
            output_file(picture, force=force, inputs=(recording, *models))
        content, tables = _recorded(recording, models, picture)
    elif table2:
        unused = ("samples", "seed", "workers")
        refuse_given(context, unused, "with --table2, which draws no samples")
        content, tables = _table2("".join(models))
    elif models:
        content, tables = _one_model(models[0], samples, seed, workers)
    else:
        content, tables = _comparison(samples, seed, workers)
    if json_output:
        print_json(content)
    else:
        for table in tables:
            Console().print(table)


Result = tuple[dict[str, Any], list[Table]]
"""For programs, and for people."""


def _table2(model: str) -> Result:
    from cablesense_training.evaluation.comparison import SHIPPED, TABLE2_MODELS
    from cablesense_training.evaluation.table2 import evaluate_table2
    from cablesense_training.inference.estimator import Estimator
    from cablesense_training.inference.metadata import find_model

    estimator = Estimator.load(find_model(model or TABLE2_MODELS[SHIPPED]))
    answers = evaluate_table2(estimator)
    content = [
        {
            "true_segment": a.load.segment,
            "segment": a.segment,
            "true_angle_deg": 180.0,
            "angle_deg": a.angle_deg,
            "true_magnitude_n": a.load.weight_n,
            "magnitude_n": a.magnitude_n,
            "magnitude_error": a.magnitude_error,
        }
        for a in answers
    ]
    table = titled_table(
        "Loads hung on the physical arm (the paper's Table II)",
        *("true segment", "estimated", "off from down", "true force", "estimated force", "error"),
        rows=[
            (
                str(a.load.segment),
                str(a.segment) if a.segment else "none",
                f"{a.angle_error_deg:+.1f}°",
                f"{a.load.weight_n:.2f} N",
                f"{a.magnitude_n:.2f} N",
                f"{a.magnitude_error:+.1%}",
            )
            for a in answers
        ],
    )
    return {"model": estimator.metadata.network, "rows": content}, [table]


def _recorded(recording: Path, models: list[str], picture: Path | None) -> Result:
    from cablesense_gap.recorded_contacts import recorded_errors
    from cablesense_gap.recordings.checks import read_recording
    from cablesense_gap.report.pictures import drawn_errors
    from cablesense_gap.report.style import image_bytes, style
    from cablesense_training.inference.metadata import find_model
    from cablesense_training.inference.temporal_estimator import open_estimator

    opened = {name: open_estimator(find_model(name)) for name in models}
    found = {
        name: recorded_errors(read_recording(recording, estimator.metadata.arm), estimator)
        for name, estimator in opened.items()
    }
    if picture is not None:
        with style():
            image = image_bytes(drawn_errors(found), "png")
        write_atomically(picture, image, OptionError)
    headings = ("", "rows", *ERRORS)
    tables = []
    for name, each in found.items():
        parts = [("all loads", each.whole.errors)]
        parts += [(f"segment {n}", part.errors) for n, part in each.by_segment.items()]
        parts += [
            (f"{part.low_n:g} to {part.high_n:g} N", part.errors)
            for part in each.whole.bins
            if part.errors.contacts
        ]
        rows = [(what, f"{e.contacts:,}", *error_cells(e)) for what, e in parts]
        if not math.isnan(each.false_n):
            free = (each.truth.segment == 0).sum()
            rows.append(
                ("released", f"{free:,}", "", "", f"{each.false_n:.3f} N estimated", "", "")
            )
        title = f"{name} on {recording.name}, arm {opened[name].metadata.arm_identity}"
        tables.append(titled_table(title, *headings, right=headings[1:], rows=rows))
    return {name: each.as_json() for name, each in found.items()}, tables


def _one_model(model: str, samples: int, seed: int, workers: int) -> Result:
    from cablesense_training.data.generation import draw_dataset
    from cablesense_training.data.protocols import SingleContact
    from cablesense_training.evaluation.comparison import evaluate_estimator, metrics_json
    from cablesense_training.evaluation.noise_bound import noise_bound
    from cablesense_training.inference.estimator import Estimator
    from cablesense_training.inference.metadata import find_model

    estimator = Estimator.load(find_model(model))
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
    bound = noise_bound(dataset)
    title = f"{described.network} on {described.arm_identity}, {samples} fresh samples"
    return (
        {"single": metrics_json(metrics), "bound": asdict(bound)},
        [_errors_table(title, {described.network: metrics}, bound)],
    )


def _comparison(samples: int, seed: int, workers: int) -> Result:
    from cablesense_training.evaluation.comparison import SHIPPED, as_json, compare

    with Console(stderr=True).status("Evaluating …") as status:
        comparison = compare(
            seed, samples, workers, lambda name: status.update(f"Evaluating {name} …")
        )
    labels = {SHIPPED: "shipped model"}
    tables = [
        _errors_table(
            evaluation.setting.replace("_", " "),
            {labels.get(n, n.replace("_", " ")): m for n, m in evaluation.models.items()},
            evaluation.bound,
        )
        for evaluation in comparison.settings
    ]
    rows = [
        (
            name.replace("_", " "),
            f"{multi.recognition_accuracy:.2%}",
            f"{multi.macro_f1:.4f}",
            ", ".join(f"{value:.2f}" for value in multi.magnitude_mae_n) + " N",
        )
        for name, multi in comparison.multi.items()
    ]
    headings = ("estimator", "recognised", "macro F1", "force MAE by segment")
    several = titled_table("several contacts", *headings, rows=rows)
    return as_json(comparison), [*tables, several]


def _errors_table(title: str, models: dict[str, SingleContactMetrics], bound: NoiseBound) -> Table:
    """Errors of models on the same samples, and of the noise bound."""
    rows = [
        (name, f"{metrics.contact_accuracy:.2%}", *error_cells(metrics.errors)[1:])
        for name, metrics in models.items()
    ]
    mae, rmse = f"{bound.magnitude_mae_n:.3f} N", f"{bound.magnitude_rmse_n:.3f} N"
    rows.append(("noise bound", "", f"{bound.direction_mae_deg:.3f}°", mae, rmse, ""))
    return titled_table(title, "estimator", *ERRORS, rows=rows)
