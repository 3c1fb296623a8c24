"""`cablesense info` shows an arm, model, calibration or effects; `cablesense urdf` writes an arm.

Each description consists of plain values, which `--json` and the tables show.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.console import Console

from cablesense_base import Array, CableSenseError
from cablesense_base.files import OutputError, output_file, read_bounded_bytes, write_atomically
from cablesense_base.installation import config_path
from cablesense_contact.felt_arm import FeltArm
from cablesense_ros.cli.options import (
    ForceOption,
    JsonOption,
    VerboseOption,
    print_json,
    print_result,
    print_summary,
    refuse_given,
)
from cablesense_ros.cli.summaries import arm_lines, effect_lines, model_lines
from cablesense_sim.arm import Arm, find_arm, load_arm, open_arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.built_arm import unloaded_scatter_n
from cablesense_sim.effects.effect import Effect, Parameter
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.load_capacity import (
    SEARCHED_UP_TO_N,
    SHOWS_AT_STD,
    contact_range_n,
    hidden_force,
    load_capacity,
)
from cablesense_sim.machine.description import is_machine_file
from cablesense_sim.noise_bound import contact_information
from cablesense_sim.replay import difference_variance_n2
from cablesense_sim.touch import touched_places

Description = dict[str, Any]
_SLOWEST_HZ = 2.0
"""Slower sensors are questioned, as the rate looks like one in another unit."""
_SCATTER_SHARE = 0.5
"""Of the pretension, by which arms may scatter: two such deviations take a cable slack."""


def info(
    context: typer.Context,
    file: Annotated[
        str,
        typer.Argument(
            help="An arm or machine file (.yaml), a model file (.onnx) or a calibration file: a "
            "path, or a bundled arm's name."
        ),
    ] = "cdsm",
    effects: Annotated[
        bool, typer.Option("--effects", help="Show the effects that an arm file can list instead.")
    ] = False,
    blind: Annotated[
        bool,
        typer.Option(
            "--blind",
            help="Show the force that friction hides instead: by segment, the smallest changes of "
            "a contact force that the arm's readings show.",
        ),
    ] = False,
    observability: Annotated[
        bool,
        typer.Option(
            "--observability",
            help="Show what tensions tell of a contact instead: by segment and pose, the standard "
            "deviations of its place and force that no estimate from one sample can be below.",
        ),
    ] = False,
    load_n: Annotated[
        float | None,
        typer.Option(
            min=0.01,
            help="With --blind: the load that comes and goes, N. With --observability: the "
            "lateral force.",
            show_default="20; of a machine a fifth of touch.largest_n",
        ),
    ] = None,
    bend_deg: Annotated[
        float,
        typer.Option(
            help="With --blind: the angle of every joint, degrees. With --observability: "
            "random joint angles up to this."
        ),
    ] = 5.0,
    picture: Annotated[
        Path | None,
        typer.Option(help="With --observability: also draw the bound along the arm, as PNG."),
    ] = None,
    force: ForceOption = False,
    template: Annotated[
        bool, typer.Option("--template", help="Print an arm file to start from instead.")
    ] = False,
    verbose: VerboseOption = False,
    json_output: JsonOption = False,
) -> None:
    """Show what an arm or a model is: geometry, cables, sensors; or inputs, outputs, training.

    Of a calibration file: how well it knows its arm, and whether that is built as its file says.

    With --effects: what real arms do beyond the ideal, with places, parameters and sources.
    With --blind: how much more or less an arm can be pushed before its readings show it.
    With --observability: how well tensions determine where and how hard an arm is touched.

    Examples: [bold]cablesense info cdsm[/bold], [bold]cablesense info my_arm.yaml --json[/bold],
    [bold]cablesense info config/models/cdsm.onnx[/bold], [bold]cablesense info --effects[/bold],
    [bold]cablesense info cdsm_friction --blind --load-n 30[/bold],
    [bold]cablesense info cdsm --observability --load-n 10[/bold],
    [bold]cablesense info --template > my_arm.yaml[/bold]
    """
    if not (blind or observability):
        refuse_given(context, ["load_n", "bend_deg"], "without --blind or --observability")
    if not observability:
        refuse_given(context, ["picture", "force"], "without --observability")
    if template:
        others = ["file", "effects", "blind", "observability", "verbose", "json_output"]
        refuse_given(context, others, "with --template")
        print(config_path("arm_template.yaml").read_text(encoding="utf-8"), end="")
        return
    lines: list[str] = []
    if effects:
        why = "with --effects, which are the same for every arm"
        refuse_given(context, ["file", "blind", "observability"], why)
        known = {name: _effect(effect) for name, effect in known_effects().items()}
        title = "Effects that an arm file can list"
        description = {"effects": known}
        lines = effect_lines(description)
    elif is_machine_file(file):
        refuse_given(context, ["blind", "picture", "bend_deg"], "of a machine file")
        machine = _machine(file, load_n, observability=observability)
        title = machine.title
        description = machine.description
        if machine.warning and not json_output:
            Console(stderr=True).print(machine.warning, highlight=False, markup=False)
    elif observability:
        refuse_given(context, ["blind"], "with --observability")
        title = "Cramér-Rao bound of a contact"
        description = _observability(open_arm(file), load_n or _LOAD_N, bend_deg)
        if picture is not None:
            path = output_file(picture, force=force)
            _draw_observability(path, open_arm(file), load_n or _LOAD_N, bend_deg)
    elif blind:
        title = "Smallest change of a contact force that the readings show, by segment, N"
        description = _hidden_force(file, load_n or _LOAD_N, bend_deg)
    elif file.endswith(".onnx"):
        title = "Model"
        description = _model(file)
        lines = model_lines(description)
    elif (content := _calibration_content(file)) is not None:
        _show_calibration(content, file, json_output)
        return
    else:
        title = "Arm"
        description = _arm(file)
        lines = arm_lines(description)
    if lines:
        print_summary(title, lines, description, as_json=json_output, verbose=verbose)
    else:
        refuse_given(context, ["verbose"], "here, where a table is all that there is")
        print_result(title, description, json_output)


class _OfMachine(NamedTuple):
    """What is printed of a machine; the warning is empty where there is nothing to mend."""

    title: str
    description: Description
    warning: str


def _machine(file: str, load_n: float | None, *, observability: bool) -> _OfMachine:
    from cablesense_ros.cli.machine_info import (
        machine_description,
        machine_observability,
        notes_on_links,
        weak_links,
    )

    if observability:
        seen = machine_observability(file, load_n)
        return _OfMachine("What one reading tells of a contact", seen, notes_on_links(seen))
    described = machine_description(file)
    return _OfMachine("Machine", described, weak_links(described))


def urdf(
    arm: Annotated[
        str, typer.Argument(help="Arm file: a path, or a bundled arm's name.")
    ] = "cdsm",
    out: Annotated[
        Path | None, typer.Option(help="Write it to this file.", show_default="standard output")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Write the URDF of an arm: links, joints, inertia, and shapes to see and to collide with.

    Joints have the names of joint_states; cables have no place in a URDF.

    Example: cablesense urdf my_arm.yaml --out my_arm.urdf
    """
    from cablesense_sim.urdf import urdf_xml

    file = find_arm(arm)
    if out is not None:
        output_file(out, force=force, inputs=(file,))
    text = urdf_xml(load_arm(file))
    if out is None:
        print(text)
    else:
        write_atomically(out, text + "\n", OutputError)


def _arm(name: str) -> Description:
    """Identity, geometry, cables and sensors as drawn, effects, and what the arm bears; SI."""
    path = find_arm(name)
    arm = load_arm(path)
    mechanism = mechanism_of(arm)
    bears = load_capacity(arm)
    angle_deg = np.rad2deg(np.arctan2(mechanism.hole_y_m, mechanism.hole_z_m)) % 360.0
    description: Description = {
        "kind": "arm",
        "file": str(path),
        "name": arm.name,
        "identity": arm.identity,
        "segments": {
            "count": arm.segment_count,
            "length_m": mechanism.segment_length_m.tolist(),
            "mass_kg": mechanism.mass_kg.tolist(),
            "contact_m": mechanism.contact_m.tolist(),
            "plate_offset_m": mechanism.plate_offset_m,
        },
        "cables": [
            {
                "name": cable_name,
                "ends_on_segment": int(mechanism.cable_segment[i]),
                "angle_deg": round(float(angle_deg[i]), 6) % 360.0,
                "radius_m": math.hypot(mechanism.hole_y_m[i], mechanism.hole_z_m[i]),
                "length_m": float(mechanism.straight_length_m[i]),
                "stiffness_n_m": float(mechanism.stiffness_n_m[i]),
                "pretension_n": float(mechanism.pretension_n[i]),
            }
            for i, cable_name in enumerate(arm.cable_names)
        ],
        "sensors": _picked(arm.sensors, "rate_hz", "noise_std_n", "step_n", "range_n"),
        "joints": list(arm.joint_names),
        "bears": {
            "sag_deg": bears.sag_deg,
            "sag_m": bears.sag_m,
            "greatest_n": bears.greatest_n.tolist(),
            "searched_up_to_n": SEARCHED_UP_TO_N,
            "contact_range_n": contact_range_n(arm),
        },
        "breath": _breath(arm),
        "unloaded_scatter_n": unloaded_scatter_n(arm),
        "effects": [_listed_effect(arm, entry) for entry in entries_of(arm)],
    }
    if questions := list(_questions(arm, description["unloaded_scatter_n"])):
        description["questions"] = questions
    return description


def _questions(arm: Arm, scatter_n: float | None) -> Iterator[str]:
    """What is possible in an arm file, and hardly meant."""
    rate_hz = arm.sensors.rate_hz
    if rate_hz < _SLOWEST_HZ:
        yield (
            f"sensors.rate_hz = {rate_hz:g}: is a reading every {1.0 / rate_hz:g} s meant? A "
            f"contact is over by then; it must be in Hz: {1e3 * rate_hz:g} if given in kHz, "
            f"{1.0 / rate_hz:g} if it is a period in s"
        )
    pretension_n = float(mechanism_of(arm).pretension_n.min())
    if scatter_n is None:
        yield "tolerances: no arm that is built so finds rest; are they meant to be so large?"
    elif scatter_n > _SCATTER_SHARE * pretension_n:
        holes_mm = 1e3 * arm.tolerances.hole_radial_m
        yield (
            f"tolerances: arms that are built so read {scatter_n:.0f} N (RMS) otherwise than the "
            f"file says, with a pretension of {pretension_n:g} N, and little stands out of that. "
            f"With cables this stiff, are holes no more precise than {holes_mm:g} mm?"
        )


def _listed_effect(arm: Arm, entry: Any) -> Description:
    history = entry.effect.history(arm.segment_count, arm.cable_count)
    parameters = {
        parameter.name: {"value": entry.values[parameter.name], "unit": parameter.unit}
        for parameter in (*entry.effect.parameters, *history)
        if parameter.name in entry.values
    }
    return {"effect": entry.effect.name, "at": entry.place, "parameters": parameters}


def _breath(arm: Arm) -> Description:
    """The least circle that turns every guide of the straight arm, or why there is none."""
    from cablesense_online.breathing import breath_circle

    try:
        circle = breath_circle(arm, np.zeros(arm.joint_count))
    except CableSenseError as error:
        return {"none": str(error)}
    return {"amplitude_deg": math.degrees(circle.largest_rad), "tip_m": circle.tip_m}


def _picked(thing: object, *names: str) -> Description:
    return {name: getattr(thing, name) for name in names}


def _model(path: str) -> Description:
    """A model file's inputs, outputs and metadata."""
    from cablesense_contact.inference.metadata import find_model
    from cablesense_contact.inference.model_file import read_model

    file = find_model(path)
    model, metadata = read_model(file)

    def port(of_graph: Any) -> Description:
        dims = of_graph.type.tensor_type.shape.dim
        shape = [dim.dim_param or dim.dim_value for dim in dims]
        name = of_graph.name
        return {"name": name, "unit": metadata.units.get(name, "1"), "shape": shape}

    return {
        "kind": "model",
        "file": str(file),
        "size_bytes": file.stat().st_size,
        "inputs": [port(each) for each in model.graph.input],
        "outputs": [port(each) for each in model.graph.output],
        "metadata": metadata.model_dump(mode="json", exclude={"arm", "units"}),
    }


def _calibration_content(path: str) -> bytes | None:
    """The content of a calibration file; None of other files."""
    from cablesense_contact.calibration import CalibrationError
    from cablesense_contact.calibration_file import MAX_FILE_BYTES, is_calibration

    if not Path(path).is_file():
        return None
    content = read_bounded_bytes(path, MAX_FILE_BYTES, "a calibration file", CalibrationError)
    return content if is_calibration(content) else None


def _show_calibration(content: bytes, path: str, as_json: bool) -> None:
    """Print what a calibration file says, in the words of `cablesense calibrate`."""
    from rich.console import Console

    from cablesense_contact.calibration_file import CalibratedMachine, calibration_of, described
    from cablesense_ros.cli.calibrate import (
        calibration_description,
        law_of,
        opened_arm,
        print_calibration,
    )

    whose = described(content, path)
    machine = (
        whose if isinstance(whose, CalibratedMachine) else CalibratedMachine.of(FeltArm(whose))
    )
    calibration = calibration_of(content, machine, path)
    known = None
    if isinstance(whose, Arm):
        # without PyTorch or a model file nothing is said of how well forces are known
        with suppress(ModuleNotFoundError):
            known = opened_arm(whose, law_of(whose, path))
    description = calibration_description(calibration, machine.parameters, known)
    if as_json:
        print_json({"file": path, **description})
    else:
        print_calibration(Console(), description)


def _hidden_force(name: str, load_n: float, bend_deg: float) -> Description:
    """Medians and largest over the directions of `cablesense_sim.load_capacity`, by segment, N.

    None means more than the load. The arm goes from straight to `bend_deg` in every joint.
    """
    arm = open_arm(name)
    forces_n = hidden_force(arm, np.full(arm.joint_count, np.deg2rad(bend_deg)), load_n)

    def plain(values_n: Array) -> Description:
        figures = {"median": np.median(values_n), "largest": values_n.max()}
        return {k: round(float(v), 3) if np.isfinite(v) else None for k, v in figures.items()}

    return {
        "kind": "hidden force",
        "name": arm.name,
        "identity": arm.identity,
        "load_n": load_n,
        "bend_deg": bend_deg,
        "shows_at_std": SHOWS_AT_STD,
        "segments": [
            {when: plain(values_n[n]) for when, values_n in forces_n._asdict().items()}
            for n in range(arm.segment_count)
        ],
    }


def _effect(effect: Effect) -> Description:
    """An effect as plain values, its places and history those of four segments, twelve cables."""

    def plain(parameters: Iterable[Parameter]) -> list[Description]:
        keys = ("name", "unit", "low", "high", "typical", "default", "role", "about")
        return [_picked(parameter, *keys) for parameter in parameters]

    return {
        **_picked(effect, "name", "acts_on", "about", "tolerance", "source"),
        "places_of_four_segments_and_twelve_cables": list(effect.places(4, 12)),
        "parameters": plain(effect.parameters),
        "history_of_four_segments_and_twelve_cables": plain(effect.history(4, 12)),
    }


_TARE_SAMPLES = 50
"""The node averages as many for a tare by default."""
_AXIAL_STD_N = 100.0
"""Deviation of the prior of the axial force."""
_LARGEST_N = 200.0
"""Largest lateral force of the prior."""
_LOAD_N = 20.0
"""Load on an arm, unless the user states another one."""
_DRAWS = 100
"""Poses, places and directions over which a bound is taken."""
_PLACES = 12
"""Along a segment, in the table of bounds."""
_DETERMINED = 0.5
"""A number is called undetermined if the bound exceeds this share of its prior's deviation."""


def _observability(arm: Arm, force_n: float, bend_deg: float) -> Description:
    """Medians of the bound by segment, of the straight arm and of bent ones.

    Poses, places and directions are random. A number that tensions do not determine is None.
    """
    low, high = touched_places(arm).touched_m.T
    known = {
        "place_mm": _DETERMINED * 1e3 * (high - low) / np.sqrt(12.0),
        "lateral_n": np.full(arm.segment_count, _DETERMINED * force_n),
        "axial_n": np.full(arm.segment_count, _DETERMINED * _AXIAL_STD_N),
    }
    medians: Description = {}
    for pose, bend in (("straight", 0.0), (f"joints within {bend_deg:g} degrees", bend_deg)):
        medians[pose] = {}
        for n in range(arm.segment_count):
            bound = _noise_bound(arm, n, force_n, bend)
            median = {key: float(f"{np.median(values):.3g}") for key, values in bound.items()}
            medians[pose][f"segment {n + 1}"] = {
                key: None if key in known and value > known[key][n] else value
                for key, value in median.items()
            }
    return {
        "arm": arm.identity,
        "contact_n": force_n,
        "poses, places and directions": _DRAWS,
        **medians,
    }


def _noise_bound(
    arm: Arm, n: int, force_n: float, bend_deg: float, at_m: float | None = None
) -> dict[str, Array]:
    """Standard deviations (B,) that one sample leaves of lateral forces on segment `n`, from 0.

    They act in random directions, joints within `bend_deg`: at `at_m`, or anywhere on the segment.
    """
    rng = np.random.default_rng(n)
    mechanism = mechanism_of(arm)
    low, high = touched_places(arm).touched_m[n]
    place_m = rng.uniform(low, high, _DRAWS) if at_m is None else np.full(_DRAWS, at_m)
    bend = np.deg2rad(bend_deg)
    command_rad = rng.uniform(-bend, bend, (_DRAWS, arm.joint_count))
    angle = rng.uniform(0.0, 2.0 * np.pi, _DRAWS)
    along = np.stack([np.zeros(_DRAWS), np.sin(angle), np.cos(angle)], axis=1)
    variance_n2 = difference_variance_n2(arm.sensors, _TARE_SAMPLES)
    segments = np.full(_DRAWS, n + 1)
    information = contact_information(
        mechanism, command_rad, segments, place_m, force_n * along, variance_n2
    )
    lateral = _LARGEST_N**-2  # at a joint's own centre no force turns it
    prior = np.diag([_AXIAL_STD_N**-2, lateral, lateral, 12.0 / (high - low) ** 2])
    covariance = np.linalg.inv(information + prior)  # (B, 4, 4) of force and place

    def deviation(of_force: Array, of_place: float) -> Array:
        gradient = np.column_stack([of_force, np.full(_DRAWS, of_place)])
        return np.sqrt(np.einsum("bi,bij,bj->b", gradient, covariance, gradient))

    return {
        "place_mm": 1e3 * np.sqrt(covariance[:, 3, 3]),
        "lateral_n": deviation(along, 0.0),
        "axial_n": np.sqrt(covariance[:, 0, 0]),
        "moment_n_m": deviation(place_m[:, None] * along, force_n),
    }


def _draw_observability(path: Path, arm: Arm, force_n: float, bend_deg: float) -> None:
    """Draw the bound along the arm, as PNG or SVG by the file's ending."""
    from matplotlib.figure import Figure

    touched_m = touched_places(arm).touched_m
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    titles = {
        "place_mm": "place, mm",
        "lateral_n": "lateral force, N",
        "axial_n": "axial force, N",
    }
    panels = dict(zip(titles, figure.subplots(1, 3, sharex=True), strict=True))
    for bend, style, colour in ((0.0, "--", "C0"), (bend_deg, "-", "C1")):
        for n, (low, high) in enumerate(touched_m):
            places_m = np.linspace(low, high, _PLACES)
            bounds = [_noise_bound(arm, n, force_n, bend, place_m) for place_m in places_m]
            label = f"joints within {bend:g}°" if n == 0 else None
            for key, axes in panels.items():
                median = [np.median(bound[key]) for bound in bounds]
                axes.semilogy(n + 1 + places_m / high, median, style, color=colour, label=label)
    for key, axes in panels.items():
        axes.set(
            title=titles[key],
            xlabel="along the arm, segments",
            xticks=range(1, len(touched_m) + 2),
        )
        axes.grid(which="both", alpha=0.2)
    panels["place_mm"].legend()
    figure.suptitle(
        f"{arm.name}: standard deviations that one sample leaves of a contact of {force_n:g} N"
    )
    drawn = io.BytesIO()
    figure.savefig(drawn, format=path.suffix.removeprefix(".") or "png", dpi=110)
    write_atomically(path, drawn.getvalue(), OutputError)
