"""The folder that a diagnosis leaves: verdict, amended arm or robot, the report with its pictures.

An arm's pictures are half as wide as the page, so that a phone shows them large enough to read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle, pairwise
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from cablesense_base import CableSenseError
from cablesense_base.files import write_atomically
from cablesense_gap.amended_arm import AMENDED_ARM, write_arm
from cablesense_gap.arm_system import Diagnosis
from cablesense_gap.recorded_contacts import RecordedErrors
from cablesense_gap.report import text
from cablesense_gap.report.next_step import Given, next_step, robot_next_step
from cablesense_gap.report.style import (
    AFTER,
    BEFORE,
    FLOOR,
    INK,
    LOADED,
    OTHER,
    WIDTH_IN,
    Line,
    ReportError,
    as_uri,
    draw_lines,
    rendered,
    style,
)
from cablesense_gap.residuals import ALL, EVERYWHERE, TRIAL, decompose
from cablesense_gap.verdict import CANNOT_TELL, NONE, UNKNOWN, Verdict, VerdictError, write_verdict
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of

if TYPE_CHECKING:
    from cablesense_gap.robot.system import RobotDiagnosis

DIAGNOSIS_FILES = ("verdict.json", AMENDED_ARM, "report.html")

_WORST = 8
"""Parts of the remaining gap that are shown at first."""
_WIDTH_IN = 5.1
"""Of a chart, inches: half of a page."""
_CAUSES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9")
"""Colours of causes in the picture of the arm; from the sixth on they repeat."""
_MOST_CABLES = 24
"""That have a chart of their own: those with the largest residuals."""
_MOST_COLUMNS = 3
"""Of charts of cables side by side."""
_ROW_IN = 0.95
"""Height of a row of them, inches."""


def write_diagnosis(
    folder: Path,
    found: Diagnosis,
    models: Mapping[str, RecordedErrors] = MappingProxyType({}),
    given: Given | None = None,
) -> None:
    """Write all three files, each whole or not at all; arguments as `report_page` takes them.

    Raises:
        VerdictError, ReportError: a file cannot be written, or the folder not be made.
        ArmFileError: the arm file cannot be written.
    """
    given = given or Given(recording=found.recording.name, out=str(folder))
    _write_both(folder, found.verdict, report_page(found, models, given))
    write_arm(folder / AMENDED_ARM, found.amended, text.headline(found.verdict))


def write_robot_diagnosis(folder: Path, found: RobotDiagnosis, given: Given | None = None) -> None:
    """Write all four files, each whole or not at all.

    Raises:
        VerdictError, ReportError: a file cannot be written, or the folder not be made.
        RobotError: the amended model cannot be written.
    """
    from cablesense_gap.robot.amending import write_amended

    _write_both(folder, found.verdict, robot_page(found, folder.name, given))
    write_amended(folder, found.system.robot, found.amended, found.beside)


def _write_both(folder: Path, verdict: Verdict, page: str) -> None:
    """Write the verdict and its page into a folder, which is made where there is none.

    Raises:
        VerdictError: the folder cannot be made, or the verdict not be written.
        ReportError: the report cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise VerdictError(f"{folder}: cannot be made ({error.strerror or error})") from error
    write_verdict(folder / "verdict.json", verdict)
    write_atomically(folder / "report.html", page, ReportError)


def report_page(
    found: Diagnosis,
    models: Mapping[str, RecordedErrors] = MappingProxyType({}),
    given: Given | None = None,
) -> str:
    """The report as one self-contained HTML page.

    `models` are errors of estimators by their names, which a picture shows side by side; `given`
    is what the diagnosis was asked for, as its next command repeats it.
    """
    verdict = found.verdict
    recording = found.recording
    floor_n = verdict.gap.floor_n
    before = decompose(recording, found.before_n, floor_n, found.nominal)
    after = decompose(recording, found.after_n, floor_n, found.nominal)
    parts = [part for part in after.parts if part.group not in (ALL, TRIAL)]
    with style():
        pictures = {
            "arm": arm_picture(found.nominal, _marked(verdict)),
            "overlay": overlay_picture(found),
            "time": time_picture(found),
            "estimator": as_uri(drawn_errors(models), "png") if models else "",
        }
    content = {
        **text.common_content(verdict),
        "sure": verdict.probability >= text.SURE,
        "recording": recording,
        "uncounted": int((~found.counted).sum()),
        "trials": len(set(recording.trial.tolist())),
        "arm": found.nominal,
        "places": text.place_text(verdict.where.places),
        "everywhere": EVERYWHERE,
        "pictures": pictures,
        "numbers": text.numbers(verdict, found.nominal),
        "before": before,
        "after": after,
        "changed": found.after_label != "",
        "worst": sorted(parts, key=lambda part: -part.over_floor)[:_WORST],
        "notes": found.notes,
        "warnings": found.warnings,
        "next": next_step(verdict, given or Given()),
        "earlier": [text.earlier_sentence(each) for each in verdict.earlier],
        "errors": text.error_rows(verdict.estimator) if verdict.estimator else [],
        "hidden": text.FRICTION_HIDES if "capstan_friction" in verdict.effects else "",
    }
    return rendered(__package__, "report.html", content)


def robot_page(found: RobotDiagnosis, folder: str, given: Given | None = None) -> str:
    """The report on a robot as one self-contained HTML page; `folder` is where it will lie."""
    from cablesense_gap.report.film import robot_film

    verdict = found.verdict
    with style():
        overlay = _robot_overlay(found)
    film = None
    no_film = ""
    try:
        film = robot_film(found)
    except CableSenseError as error:  # a report without it is whole
        no_film = str(error)
    content = {
        **text.common_content(verdict),
        "trials": int(found.system.trial.max()) + 1,
        "next": robot_next_step(
            verdict, given or Given(out=folder, external=found.system.motion.external)
        ),
        "earlier": [text.earlier_sentence(each, of_robot=True) for each in verdict.earlier],
        "notes": found.notes,
        "warnings": found.warnings,
        "forward": found.system.motion.forward,
        "external": found.system.motion.external,
        "by_command": found.system.motion.by_command,
        "overlay": overlay,
        "film": film,
        "no_film": no_film,
        "parameters": [
            (effect, " ".join(place or verdict.shares[effect].places), parameter, estimate)
            for name, estimate in verdict.parameters.items()
            for effect, *place, parameter in (name.split("."),)
        ],
    }
    return rendered(__package__, "robot.html", content)


def _marked(verdict: Verdict) -> dict[str, tuple[str, ...]]:
    """Places by cause, as the picture of the arm marks them."""
    if verdict.effects == (UNKNOWN,):
        return {"where the gap is": verdict.where.places}
    return {
        text.candidate_name((name,)): text.effect_places(verdict, name)
        for name in verdict.effects
        if name not in (NONE, CANNOT_TELL)
    }


def time_picture(found: Diagnosis) -> str:
    """Residuals as small multiples with one scale; of very many cables, the largest."""
    import matplotlib.pyplot as plt

    columns = min(found.nominal.cables.per_segment, _MOST_COLUMNS)
    size = np.nanmean(found.before_n**2, axis=0)
    cables = sorted(np.argsort(size)[-_MOST_CABLES:].tolist())
    rows = -(-len(cables) // columns)
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(_WIDTH_IN, _ROW_IN * rows + 0.9),
        sharex=True,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    # nearly all, so that one stray row hides nothing
    residuals_n = np.abs(np.concatenate([found.before_n, found.after_n]))
    known = residuals_n[np.isfinite(residuals_n)]
    largest = float(np.quantile(known, 0.999)) if known.size else 1.0
    reach_n = 1.08 * max(largest, 4.0 * found.verdict.gap.floor_n, 1e-3)
    for panel, cable in zip(axes.flat, cables, strict=False):
        _residual_panel(panel, found, cable)
        panel.set_ylim(-reach_n, reach_n)
        panel.locator_params(nbins=4)
    for panel in axes.flat[len(cables) :]:
        panel.set_visible(False)
    figure.supylabel("residual, N", fontsize=9)
    figure.supxlabel("time, s", fontsize=9)
    _legend(figure, axes[0, 0])
    return as_uri(figure, "png")


def overlay_picture(found: Diagnosis) -> str:
    """Tension measured and predicted of the cable with the largest gap, and its worst trial."""
    import matplotlib.pyplot as plt

    recording = found.recording
    squares = np.nan_to_num(found.before_n**2)
    cable = int(squares.sum(axis=0).argmax())
    numbers, number_of_row, row_counts = np.unique(
        recording.trial, return_inverse=True, return_counts=True
    )
    of_trial = np.bincount(number_of_row, squares[:, cable]) / row_counts
    trial = int(numbers[of_trial.argmax()])
    name = found.nominal.cable_names[cable].replace("_", " ")
    figure, axes = plt.subplots(2, 1, figsize=(_WIDTH_IN, 4.4), layout="constrained")
    for panel, rows, title in (
        (axes[0], np.ones(len(recording), dtype=bool), f"{name}: the recording"),
        (axes[1], recording.trial == trial, f"{name}: trial {trial}, where its gap is largest"),
    ):
        time_s = recording.time_s[rows]
        measured_n = recording.tensions_n[rows, cable]
        lines: list[Line] = [(measured_n, INK, 2.4, "measured")]
        lines.append((measured_n - found.before_n[rows, cable], BEFORE, 1.3, "nominal arm"))
        if found.after_label:
            lines.append((measured_n - found.after_n[rows, cable], AFTER, 1.0, found.after_label))
        draw_lines(panel, time_s, lines)
        panel.set_title(title, pad=3)
        panel.set(xlabel="time, s", ylabel="tension, N", xlim=(time_s[0], time_s[-1]))
    _legend(figure, axes[0])
    return as_uri(figure, "png")


def _robot_overlay(found: RobotDiagnosis) -> str:
    """The trial with the largest gap, channel by channel."""
    import matplotlib.pyplot as plt

    compared = found.system.comparison
    gap = (((compared.readings - found.before) / compared.floor) ** 2).sum(1)
    worst = int(np.bincount(compared.trial, gap).argmax())
    rows = compared.trial == worst
    figure, axes = plt.subplots(
        len(compared.names),
        1,
        figsize=(WIDTH_IN, 0.7 + 1.5 * len(compared.names)),
        sharex=True,
        squeeze=False,
        layout="constrained",
    )
    drawn: list[Line] = [
        (compared.readings, INK, 1.8, "measured"),
        (found.before, BEFORE, 1.2, "nominal model"),
    ]
    if not np.allclose(found.before, found.after):
        drawn.append((found.after, AFTER, 1.2, "amended model"))
    for c, name in enumerate(compared.names):
        lines = [(v[rows, c], colour, width, label) for v, colour, width, label in drawn]
        draw_lines(axes[c, 0], compared.time_s[rows], lines)
        axes[c, 0].set_title(name, pad=2)
        axes[c, 0].set_ylabel(compared.units[c])
    axes[-1, 0].set_xlabel("time, s")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return as_uri(figure)


def arm_picture(arm: Arm, marked: Mapping[str, Sequence[str]]) -> str:
    """The straight arm from its right side and a guide plate, with places marked by cause.

    `marked` has the places, as `cable_3`, of each cause; empty text if they are none.
    """
    import matplotlib.pyplot as plt
    from matplotlib.patches import Rectangle

    colours = dict(zip(marked, cycle(_CAUSES)))
    of_place = {place: colours[cause] for cause, places in marked.items() for place in places}
    if not of_place:
        return ""
    m = mechanism_of(arm)
    figure, (side, plate) = plt.subplots(
        1, 2, figsize=(_WIDTH_IN, 2.3), width_ratios=(2.6, 1.0), layout="constrained"
    )
    reach = 1.25 * float(np.hypot(m.hole_y_m, m.hole_z_m).max())
    joint_m = m.plate_offset_m + np.concatenate([[0.0], np.cumsum(m.segment_length_m)])
    for n, (begin, end) in enumerate(pairwise(joint_m), 1):
        fill = of_place.get(f"segment_{n}", LOADED)
        x = begin + m.plate_offset_m
        long = end - begin - 2.0 * m.plate_offset_m
        side.add_patch(Rectangle((x, -reach), long, 2.0 * reach, fc=fill, ec=OTHER, alpha=0.6))
        side.text(x + 0.5 * long, -1.08 * reach, n, ha="center", va="top", size=8)
        ring = of_place.get(f"joint_{n}")
        side.plot(begin, 0.0, "o", ms=9 if ring else 4, color=ring or OTHER, zorder=4)
        if ring:
            side.text(begin, 1.08 * reach, f"joint {n}", ha="center", va="bottom", size=8)
    side.vlines(0.0, -reach, reach, color=OTHER, lw=3)
    for i, (n, y, z) in enumerate(zip(m.cable_segment, m.hole_y_m, m.hole_z_m, strict=True), 1):
        colour = of_place.get(f"cable_{i}")
        drawn: Any = {"color": colour or OTHER, "zorder": 3 if colour else 2}
        end = joint_m[n - 1] + m.plate_offset_m
        side.plot([-m.run_m, end], [z, z], lw=2.0 if colour else 0.6, **drawn)
        plate.plot(y, z, "o", ms=8 if colour else 4, **drawn)
        plate.text(
            1.24 * y,
            1.24 * z,
            i,
            ha="center",
            va="center",
            size=8,
            weight="bold" if colour else "normal",
        )
    side.text(-m.run_m, -1.08 * reach, "actuators     segment", va="top", size=8)
    plate.set_title("cables, from the tip", loc="center", size=8)
    plate.set(xlim=(1.2 * reach, -1.2 * reach), ylim=(-1.2 * reach, 1.2 * reach))
    plate.set_aspect("equal")
    side.set_ylim(-1.5 * reach, 1.5 * reach)
    for axes in (side, plate):
        axes.axis("off")
    for cause, places in marked.items():
        if places:
            side.plot([], [], "s", color=colours[cause], label=cause)
    figure.legend(loc="outside upper center", ncols=3, fontsize=9)
    return as_uri(figure)


def _legend(figure: Any, axes: Any) -> None:
    handles = axes.get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper right", ncols=4, fontsize=8, columnspacing=1.0)


def _residual_panel(panel: Any, found: Diagnosis, cable: int) -> None:
    from matplotlib.transforms import blended_transform_factory

    recording = found.recording
    floor_n = found.verdict.gap.floor_n
    panel.fill_between(
        recording.time_s,
        0.0,
        1.0,
        where=recording.load_segment > 0,
        step="mid",
        color=LOADED,
        lw=0,
        label="a load acts",
        transform=blended_transform_factory(panel.transData, panel.transAxes),
    )
    panel.axhspan(-2.0 * floor_n, 2.0 * floor_n, color=FLOOR, alpha=0.28, lw=0, label="±2 floors")
    lines: list[Line] = [(found.before_n[:, cable], BEFORE, 1.4, "nominal arm")]
    if found.after_label:
        lines.append((found.after_n[:, cable], AFTER, 0.9, found.after_label))
    draw_lines(panel, recording.time_s, lines)
    panel.set_title(found.nominal.cable_names[cable].replace("_", " "), pad=2)
    panel.set_xlim(recording.time_s[0], recording.time_s[-1])


def drawn_errors(errors: Mapping[str, RecordedErrors]) -> Any:
    """Estimated against true force of each model, side by side: a colour for each link."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        1, len(errors), figsize=(4.4 * len(errors), 4.2), squeeze=False, layout="constrained"
    )
    most = 1.05 * max(
        max(each.truth.force_n.max(), each.answer.force_n.max()) for each in errors.values()
    )
    for place, (name, model_errors) in zip(axes[0], errors.items(), strict=True):
        place.plot([0.0, most], [0.0, most], color="0.7", lw=1)
        right = model_errors.answer.segment == model_errors.truth.segment
        for segment in np.unique(model_errors.truth.segment):
            rows = model_errors.truth.segment == segment
            colour = f"C{segment}" if segment else "0.4"
            label = model_errors.links[segment - 1] if segment else "no load"
            forces = model_errors.truth.force_n, model_errors.answer.force_n
            place.plot(*(f[rows & right] for f in forces), ".", ms=4, c=colour, label=label)
            place.plot(*(f[rows & ~right] for f in forces), "x", ms=5, c=colour)
        accuracy = model_errors.whole.contact_accuracy
        off_n = model_errors.whole.errors.magnitude_mae_n
        place.set(
            title=f"{name}\nright link {accuracy:.1%}, force off by {off_n:.2g} N",
            xlabel="true force, N (crosses: another link, or none)",
            ylabel="estimated force, N",
        )
        place.legend()
    return figure
