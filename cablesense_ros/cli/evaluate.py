"""`cablesense evaluate` and `paper`: how good the estimators are, and the paper's studies."""

from __future__ import annotations

import os
import sys
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import TaskID

from cablesense_base.files import output_file, write_atomically
from cablesense_base.installation import examples_parent
from cablesense_ros.cli.options import (
    ForceOption,
    JsonOption,
    OptionError,
    WorkersOption,
    print_json,
    print_result,
    refuse_given,
    task_bars,
)


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
            help="Evaluate this model of one contact, or of contacts anywhere (a path, or a "
            "bundled name) alone, on its own arm. With --recording repeatable: before and after "
            "an adaptation."
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
        title, content = _recorded(recording, models, picture)
    elif table2:
        unused = ("samples", "seed", "workers")
        refuse_given(context, unused, "with --table2, which draws no samples")
        title, content = _table2("".join(models))
    elif models:
        title, content = _one_model(models[0], samples, seed, workers)
    else:
        title, content = _comparison(samples, seed, workers)
    print_result(title, content, json_output)


Result = tuple[str, dict[str, Any]]
"""A title, and figures as plain values."""


def _table2(model: str) -> Result:
    from cablesense_training.evaluation.comparison import (
        DOWN_DEG,
        SHIPPED,
        TABLE2_MODELS,
        evaluate_table2,
    )
    from cablesense_training.inference.estimator import Estimator
    from cablesense_training.inference.metadata import find_model

    estimator = Estimator.load(find_model(model or TABLE2_MODELS[SHIPPED]))
    content = [
        {
            "true_segment": load.segment,
            "segment": found.segment,
            "true_angle_deg": DOWN_DEG,
            "angle_deg": found.angle_deg,
            "true_magnitude_n": load.weight_n,
            "magnitude_n": found.magnitude_n,
            "magnitude_error": found.magnitude_n / load.weight_n - 1.0,
        }
        for load, found in evaluate_table2(estimator)
    ]
    title = "Loads hung on the physical arm (the paper's Table II)"
    return title, {"model": estimator.metadata.network, "rows": content}


def _recorded(recording: Path, models: list[str], picture: Path | None) -> Result:
    from cablesense_gap.recorded_contacts import recorded_errors
    from cablesense_gap.recordings.checks import read_recording
    from cablesense_gap.report.page import drawn_errors
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
    return f"Known loads of {recording.name}", {n: each.as_json() for n, each in found.items()}


def _one_model(model: str, samples: int, seed: int, workers: int) -> Result:
    """A model's errors on samples like those of its training, next to their noise bound."""
    from cablesense_training.data.generation import draw_dataset
    from cablesense_training.data.protocols import AnywhereContact, SingleContact
    from cablesense_training.evaluation import anywhere
    from cablesense_training.evaluation.comparison import evaluate_estimator, metrics_json
    from cablesense_training.evaluation.metrics import noise_bound
    from cablesense_training.inference.anywhere import AnywhereEstimator
    from cablesense_training.inference.estimator import Estimator
    from cablesense_training.inference.metadata import ANYWHERE, find_model
    from cablesense_training.inference.model_file import read_model

    path = find_model(model)
    is_anywhere = read_model(path)[1].kind == ANYWHERE
    estimator = AnywhereEstimator.load(path) if is_anywhere else Estimator.load(path)
    described = estimator.metadata
    protocol = (AnywhereContact if is_anywhere else SingleContact)(
        samples=samples,
        pose="random" if described.pose_range_deg > 0 else "straight",
        pose_range_deg=described.pose_range_deg,
        force_high_n=described.force_range_n,
        tare_samples=described.tare_samples,
    )
    dataset = draw_dataset(described.arm, protocol, seed, workers=workers)
    title = f"{described.network} on {described.arm_identity}, {samples} fresh samples"
    if isinstance(estimator, AnywhereEstimator):
        profile = anywhere.anywhere_metrics(dataset, anywhere.commanded_profile(dataset))
        found = anywhere.evaluate_anywhere(estimator, dataset)
        return title, {"anywhere": found.as_json(), "commanded_profile": profile.as_json()}
    metrics = evaluate_estimator(estimator, dataset).metrics
    return title, {"single": metrics_json(metrics), "bound": asdict(noise_bound(dataset))}


def _comparison(samples: int, seed: int, workers: int) -> Result:
    from cablesense_training.evaluation.comparison import compare

    with Console(stderr=True).status("Evaluating …") as status:
        content = compare(
            seed, samples, workers, lambda name: status.update(f"Evaluating {name} …")
        )
    return "Bundled models, their peers, and the noise bound", content


def _study_names() -> str:
    """Names of the studies, read from the files of their texts: loads no code."""
    texts = (examples_parent() / "examples" / "paper" / "studies").glob("*.yaml")
    return ", ".join(sorted(text.stem for text in texts))


def paper(
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

    Examples: [bold]cablesense paper --out paper --quick[/bold],
    [bold]cablesense paper --out friction --only friction[/bold]
    """
    if (parent := str(examples_parent())) not in sys.path:
        sys.path.insert(0, parent)
    from examples.paper.report import claim_folder, write_report
    from examples.paper.study import FailedStudyError, chosen_studies, run_study

    for package in ("jinja2", "matplotlib"):  # missing ones are found now, not after minutes
        import_module(package)
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads that wait for each other cost minutes
    studies = chosen_studies(only or ())
    claim_folder(out, force)
    console = Console(stderr=json_output)
    outcomes = []
    with task_bars(console) as progress:
        for study in studies:
            task = progress.add_task(study.title, total=1.0)

            def show(done: float, task: TaskID = task) -> None:
                progress.update(task, completed=done)

            outcomes.append(run_study(study, quick, show))
            show(1.0)
    results = write_report(out, outcomes, quick)
    if json_output:
        print_json(results)
    console.print(f"Report: {out / 'report.html'}", soft_wrap=True)
    failed = [outcome.study.name for outcome in outcomes if outcome.failure]
    if failed:
        raise FailedStudyError(
            f"{len(failed)} of {len(studies)} studies failed: {', '.join(failed)}; "
            f"{out / 'report.html'} states why"
        )
