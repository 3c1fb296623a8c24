"""`cablesense estimate`: the contacts in a recording of tensions, as a table and a plot."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from cablesense_base.files import OutputError, output_file, write_atomically
from cablesense_base.progress import progress_bar
from cablesense_ros.cli.options import (
    ColumnsOption,
    ForceOption,
    JsonOption,
    OptionError,
    TopicsOption,
    print_json,
    print_notes,
    refuse_given,
)

if TYPE_CHECKING:
    from cablesense_contact.felt import FeltMachine
    from cablesense_msgs_py.messages import Contact
    from cablesense_online.recorded_estimates import RecordedAnswer
    from cablesense_recording.layout import Described
    from cablesense_recording.recording import Recording

_DPI = 110


def estimate(
    context: typer.Context,
    recording: Annotated[
        Path,
        typer.Argument(
            help="A .csv or .csv.gz file, a .mcap file or a rosbag2 folder; trials and loads are "
            "not needed."
        ),
    ],
    arm: Annotated[
        str,
        typer.Option(help="Arm file: a path, or the name of a bundled one; or a machine file."),
    ] = "cdsm_lab",
    model: Annotated[
        str, typer.Option(help="Model file: a bundled name, or a path. Default: the arm's own.")
    ] = "",
    columns: ColumnsOption = None,
    topic: TopicsOption = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="How well the arm is known, as a commissioning has written it; without it, the "
            "first rows at rest are a tare."
        ),
    ] = None,
    tare_rows: Annotated[
        int, typer.Option(min=1, max=10_000, help="Rows of the untouched arm that a tare takes.")
    ] = 20,
    out: Annotated[Path, typer.Option(help="The table of estimates to write, .csv.")] = Path(
        "estimates.csv"
    ),
    picture: Annotated[
        Path | None,
        typer.Option(help="The plot to write, .png, .svg or .pdf.", show_default="as --out, .png"),
    ] = None,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Estimate the contacts in a recording of readings and commands; write a table and a plot.

    Names and units of columns may be any: --columns names a file that says what they mean, the
    same as for gap diagnose and sensors check. Each row is answered as the node answers a sample.

    Examples: [bold]cablesense estimate run.mcap --arm my_arm.yaml --model my_arm.onnx[/bold],
    [bold]cablesense estimate my.csv --columns map.yaml --arm my_arm.yaml[/bold]
    """
    from cablesense_contact.calibration_file import prior_notes
    from cablesense_online.loading import load
    from cablesense_online.recorded_estimates import recorded_answers, require_tare
    from cablesense_ros.default_settings import node_settings

    if calibration is not None:
        refuse_given(context, ["tare_rows"], "with --calibration, which takes no tare")
    drawn = out.with_suffix(".png") if picture is None else picture
    if drawn == out:
        raise OptionError(f"--out {out} and the plot are one file; give another --picture")
    inputs = (recording, arm, model, columns, calibration)
    output_file(out, force=force, inputs=inputs)
    output_file(drawn, force=force, inputs=inputs)
    loaded = load(arm, model)
    recorded = _read(recording, loaded.described, columns, topic or ())
    print_notes(recorded.notes, json_output)
    known = loaded.calibration("" if calibration is None else str(calibration))
    print_notes(prior_notes(known, loaded.machine, str(calibration)), json_output)
    settings = node_settings(tare_samples=tare_rows)
    answers: list[RecordedAnswer] = []
    with progress_bar(len(recorded), what="rows") as advance:
        for answer in recorded_answers(recorded, loaded, settings, known):
            answers.append(answer)
            advance(1)
    require_tare(answers, tare_rows)
    write_atomically(out, _table(answers, loaded.machine), OutputError)
    links = [name.replace("_", " ") for name in loaded.machine.link_names]
    write_atomically(drawn, _drawn(answers, links, drawn), OutputError)
    summary = _summary(answers)
    if json_output:
        print_json({**summary, "table": str(out), "picture": str(drawn)})
        return
    for line in _lines(summary, links):
        print(line)
    print(f"table: {out}; plot: {drawn}")


def _read(
    path: Path, machine: Described, columns: Path | None, topics: Sequence[str]
) -> Recording:
    from cablesense_recording.column_map import ColumnMap, read_column_map
    from cablesense_recording.csv_file import CSV_ENDINGS
    from cablesense_recording.reading import read_recording

    described = None if columns is None else read_column_map(columns, machine)
    if described is None and path.name.lower().endswith(CSV_ENDINGS):
        described = ColumnMap()  # our names, without trials and loads
    elif described is not None:
        described = described.unloaded
    return read_recording(path, machine, topics, described)


def _table(answers: Sequence[RecordedAnswer], machine: FeltMachine) -> str:
    from cablesense_online.answer_table import ANSWER_COLUMNS, answer_cells
    from cablesense_online.placed_links import PlacedLinks

    links = PlacedLinks(machine.link_frames)
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("time_s", *ANSWER_COLUMNS, "doubt"))
    for time_s, answer, tare_problem in answers:
        why = answer.doubt or tare_problem
        if answer.problem is not None:
            why = str(answer.problem)
        table.writerow([_cell(time_s), *map(_cell, answer_cells(answer, links)), why])
    return text.getvalue()


def _cell(value: object) -> object:
    return f"{value:.6g}" if isinstance(value, float) else value


def _drawn(answers: Sequence[RecordedAnswer], links: Sequence[str], path: Path) -> bytes:
    """Force with its interval, and link, over time; grey where no force is known."""
    from matplotlib.figure import Figure

    time_s = np.array([each.time_s for each in answers])
    # without a contact it is 0, and so it is where the moment alone is known
    force_n = np.array([each.answer.contact.magnitude_n or np.nan for each in answers])
    segment = np.array([each.answer.contact.segment for each in answers])
    known = np.array([each.answer.force.known for each in answers])
    bounds = [each.answer.bounds for each in answers]
    ends = [None if number == 0 else both for number, both in zip(segment, bounds, strict=True)]
    low_n = np.array([np.nan if both is None else both[0].magnitude_n for both in ends])
    high_n = np.array([np.nan if both is None else both[1].magnitude_n for both in ends])
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    force_axes, segment_axes = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    force_axes.fill_between(time_s, low_n, high_n, alpha=0.3, lw=0.0, label="its 95 % interval")
    force_axes.plot(time_s, force_n, lw=1.5, label="contact")
    for axes in (force_axes, segment_axes):
        axes.fill_between(
            time_s, 0.0, 1.0, where=~known, color="0.9", transform=axes.get_xaxis_transform()
        )
        axes.grid(alpha=0.2)
    force_axes.set(ylabel="force, N", ylim=(0.0, None))
    force_axes.legend(loc="upper left")
    touched = np.where(segment > 0, segment, np.nan)
    segment_axes.plot(time_s, touched, ".", ms=3.0)
    segment_axes.set(
        xlabel="time, s (grey: no force is known or vouched for)", ylim=(0.5, len(links) + 0.5)
    )
    segment_axes.set_yticks(range(1, len(links) + 1), links, fontsize=7)
    content = io.BytesIO()
    figure.savefig(content, format=path.suffix.removeprefix(".") or "png", dpi=_DPI)
    return content.getvalue()


def _summary(answers: Sequence[RecordedAnswer]) -> dict[str, Any]:
    states = Counter(each.answer.force.value for each in answers)
    strongest = max(answers, key=_strength)
    contact = strongest.answer.contact
    return {
        "rows": len(answers),
        "states": dict(states.most_common()),
        "strongest": {
            "time_s": strongest.time_s,
            "segment": contact.segment,
            "place_m": contact.contact_m,
            "magnitude_n": None if _has_moment_alone(contact) else contact.magnitude_n,
            "state": strongest.answer.force.value,
        },
    }


def _strength(answered: RecordedAnswer) -> tuple[float, float]:
    """By which contacts are compared: by their forces, and below any force by their moments."""
    contact = answered.answer.contact
    return contact.magnitude_n, contact.moment_n_m or 0.0


def _has_moment_alone(contact: Contact) -> bool:
    return bool(contact.segment) and contact.magnitude_n == 0.0


def _lines(summary: dict[str, Any], links: Sequence[str]) -> list[str]:
    states = ", ".join(f"{count:,} {state}" for state, count in summary["states"].items())
    lines = [f"{summary['rows']:,} rows: {states}"]
    strongest = summary["strongest"]
    if strongest["segment"]:
        size_n = strongest["magnitude_n"]
        size = "by its moment alone" if size_n is None else f"{size_n:.3g} N"
        lines.append(
            f"strongest: {size} on {links[strongest['segment'] - 1]}, "
            f"{1e3 * strongest['place_m']:.0f} mm from its joint, at {strongest['time_s']:.2f} s "
            f"({strongest['state']})"
        )
    else:
        lines.append("no contact")
    return lines
