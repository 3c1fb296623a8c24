"""`cablesense info`: an arm file, a model file, what friction hides, or the effects' catalogue."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from cablesense_base import Array, CableSenseError
from cablesense_ros.cli.options import JsonOption, print_json, refuse_given, titled_table
from cablesense_sim.arm import Arm, find_arm, load_arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.effect import Effect, Parameter
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.hidden_force import SHOWS_AT_STD, hidden_force
from cablesense_sim.load_capacity import SEARCHED_UP_TO_N, contact_range_n, load_capacity


def info(
    context: typer.Context,
    file: Annotated[
        str,
        typer.Argument(
            help="An arm file (.yaml) or a model file (.onnx): a path, or a bundled arm's name."
        ),
    ] = "cdsm",
    effects: Annotated[
        bool,
        typer.Option(
            "--effects", help="Show the catalogue of effects that an arm file can list instead."
        ),
    ] = False,
    blind: Annotated[
        bool,
        typer.Option(
            "--blind",
            help="Show what friction hides instead: by segment, the smallest changes of a contact "
            "force that the arm's readings show.",
        ),
    ] = False,
    load_n: Annotated[
        float, typer.Option(min=0.1, help="With --blind: the load that comes and goes, N.")
    ] = 20.0,
    bend_deg: Annotated[
        float, typer.Option(help="With --blind: the command, every joint bent so far.")
    ] = 5.0,
    template: Annotated[
        bool, typer.Option("--template", help="Print an arm file to start from instead.")
    ] = False,
    keys: Annotated[
        bool,
        typer.Option("--keys", help="Print the reference of the arm file's keys instead."),
    ] = False,
    json_output: JsonOption = False,
) -> None:
    """Show what an arm or a model is: geometry, cables, sensors; or inputs, outputs, training.

    With --effects: what real arms do beyond the ideal, with places, parameters and sources.
    With --blind: how much more or less an arm can be pushed before its readings show it.

    Examples: [bold]cablesense info cdsm[/bold], [bold]cablesense info my_arm.yaml --json[/bold],
    [bold]cablesense info config/models/cdsm.onnx[/bold], [bold]cablesense info --effects[/bold],
    [bold]cablesense info cdsm_friction --blind --load-n 30[/bold],
    [bold]cablesense info --template > my_arm.yaml[/bold]
    """
    from rich.console import Console

    if template or keys:
        given = "--template" if template else "--keys"
        others = ["file", "effects", "blind", "load_n", "bend_deg", "json_output"]
        refuse_given(context, [*others, *(["keys"] if template else [])], f"with {given}")
        from cablesense_ros.cli.arm_file import arm_keys_markdown, arm_template

        print(arm_template() if template else arm_keys_markdown(), end="" if template else "\n")
        return
    if not blind:
        refuse_given(context, ["load_n", "bend_deg"], "without --blind")
    if effects:
        refuse_given(context, ["blind"], "with --effects, which are the same for every arm")
        refuse_given(context, ["file"], "with --effects, which are the same for every arm")
        known = [describe_effect(effect) for effect in known_effects().values()]
        description: Description = {"kind": "effects", "effects": known}
        tables = [_effect_table(effect) for effect in description["effects"]]
    elif blind:
        description = describe_hidden_force(file, load_n, bend_deg)
        tables = [_hidden_table(description)]
    else:
        description = describe_model(file) if file.endswith(".onnx") else describe_arm(file)
        is_arm = description["kind"] == "arm"
        tables = _arm_tables(description) if is_arm else _model_tables(description)
    if json_output:
        print_json(description)
        return
    console = Console()
    for table in tables:
        console.print(table)


Description = dict[str, Any]


def describe_arm(name: str) -> Description:
    """An arm's identity, geometry, cables and sensors as drawn, its effects, and what it bears.

    SI units, as the keys say.

    Raises:
        CableSenseError: no such arm file, one that cannot be true, or an arm that cannot stand.
    """
    path = find_arm(name)
    arm = load_arm(path)
    mechanism, bears = mechanism_of(arm), load_capacity(arm)
    angle_deg = np.rad2deg(np.arctan2(mechanism.hole_y_m, mechanism.hole_z_m)) % 360.0
    return {
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
        "effects": [
            {
                "effect": entry.effect.name,
                "at": entry.place,
                "parameters": {
                    parameter.name: {"value": entry.values[parameter.name], "unit": parameter.unit}
                    for parameter in (
                        *entry.effect.parameters,
                        *entry.effect.history(arm.segment_count, arm.cable_count),
                    )
                    if parameter.name in entry.values
                },
            }
            for entry in entries_of(arm)
        ],
    }


def _breath(arm: Arm) -> Description:
    """The least circle that turns every guide of the straight arm, or why there is none."""
    from cablesense_online.breathing import breath_circle

    try:
        circle = breath_circle(arm, np.zeros(arm.joint_count))
    except CableSenseError as error:
        return {"none": str(error)}
    return {"amplitude_deg": math.degrees(circle.largest_rad), "tip_m": circle.tip_m}


def _breath_text(breath: Description) -> str:
    if "none" in breath:
        return f"none: {breath['none']}"
    return (
        f"joints in circles of up to {breath['amplitude_deg']:.2f} degrees turn every guide; the "
        f"tip moves by {1e3 * breath['tip_m']:.2f} mm"
    )


def _bearing_facts(bears: Description) -> list[tuple[str, str]]:
    most_n = bears["searched_up_to_n"]
    greatest = _listed([min(most_n, float(f"{each:.2g}")) for each in bears["greatest_n"]])
    more = " or more" if max(bears["greatest_n"]) >= most_n else ""
    return [
        (
            "sag",
            f"{bears['sag_deg']:.2g} degrees in a joint, {1e3 * bears['sag_m']:.2g} mm at the "
            "last contact point, by its own weight",
        ),
        ("bears", f"{greatest} N{more}, segment by segment, straight and from every side"),
        ("contacts", f"drawn up to {bears['contact_range_n']:g} N unless told otherwise"),
    ]


def _picked(thing: object, *names: str) -> Description:
    return {name: getattr(thing, name) for name in names}


def _arm_tables(arm: Description) -> list[Table]:
    segments, sensors = arm["segments"], arm["sensors"]
    facts = _facts(
        f"Arm {arm['identity']}",
        ("file", arm["file"]),
        ("segments", f"{segments['count']}, of {_listed(segments['length_m'])} m"),
        ("mass", f"{_listed(segments['mass_kg'])} kg each"),
        ("guide plates", f"{segments['plate_offset_m']:g} m before and after each joint"),
        ("loads act", f"{_listed(segments['contact_m'])} m from each segment's joint"),
        (
            "sensors",
            f"{sensors['rate_hz']:g} Hz, noise {sensors['noise_std_n']:g} N (1 σ), "
            f"step {sensors['step_n']:g} N",
        ),
        *_bearing_facts(arm["bears"]),
        ("breath", _breath_text(arm["breath"])),
    )
    columns = {
        "ends on segment": "{ends_on_segment}",
        "angle, °": "{angle_deg:.0f}",
        "radius, m": "{radius_m:.3f}",
        "length, m": "{length_m:.3f}",
        "stiffness, N/m": "{stiffness_n_m:.3g}",
        "pretension, N": "{pretension_n:g}",
    }
    cables = titled_table("Cables", "name", *columns, right=columns)
    for cable in arm["cables"]:
        cables.add_row(cable["name"], *(form.format(**cable) for form in columns.values()))
    if not arm["effects"]:
        return [facts, cables]
    table = titled_table("Effects", "effect", "at", "parameters")
    for effect in arm["effects"]:
        numbers = (
            f"{name} = {given['value']:g} {_unit(given)}".strip()
            for name, given in effect["parameters"].items()
        )
        table.add_row(effect["effect"], effect["at"], "\n".join(numbers))
    return [facts, cables, table]


def describe_model(path: str) -> Description:
    """A model file's inputs, outputs and metadata.

    Raises:
        CableSenseError: the file is missing or no model.
    """
    from cablesense_training.inference.metadata import find_model
    from cablesense_training.inference.session import read_model

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


def _model_tables(model: Description) -> list[Table]:
    facts = _facts(f"Model {model['file']}", ("size", f"{model['size_bytes'] / 1000:.0f} kB"))
    for way in ("inputs", "outputs"):
        for port in model[way]:
            shape = ", ".join(map(str, port["shape"]))
            unit = f", {_unit(port)}" if _unit(port) else ""
            facts.add_row(way[:-1], f"{port['name']} ({shape}){unit}")
    for key, value in model["metadata"].items():
        shown = f"{value[0]} … {value[-1]}" if isinstance(value, list) else str(value)
        facts.add_row(key.replace("_", " "), shown)
    return [facts]


def _facts(title: str, *rows: tuple[str, str]) -> Table:
    table = Table(title=title, title_justify="left", show_header=False)
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def _listed(values: list[float]) -> str:
    return f"{values[0]:g}" if len(set(values)) == 1 else ", ".join(f"{v:g}" for v in values)


def _unit(value: Description) -> str:
    return "" if value["unit"] == "1" else str(value["unit"])


def describe_hidden_force(name: str, load_n: float, bend_deg: float) -> Description:
    """Medians and largest over the directions of `cablesense_sim.hidden_force`, by segment, N.

    None stands for more than the load. The arm goes from straight to `bend_deg` in every joint.

    Raises:
        CableSenseError: no such arm file, or one that cannot be bent or loaded so far.
    """
    arm = load_arm(find_arm(name))
    found = hidden_force(arm, np.full(arm.joint_count, np.deg2rad(bend_deg)), load_n)

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
            {when: plain(values_n[n]) for when, values_n in found._asdict().items()}
            for n in range(arm.segment_count)
        ],
    }


def _hidden_table(hidden: Description) -> Table:
    load_n = hidden["load_n"]
    columns = {
        "touching_n": "a first push",
        "rising_n": f"more, at {load_n:g} N",
        "falling_n": f"less, at {load_n:g} N",
        "released_n": "a push after release",
    }
    table = titled_table(
        f"Smallest change of a force that the readings of {hidden['name']} show, N",
        *("segment", *columns.values()),
        right=columns.values(),
    )
    table.caption = (
        "median (largest) over directions around the segment; a change shows at "
        f"{hidden['shows_at_std']:g} deviations of the readings' noise; every joint bent by "
        f"{hidden['bend_deg']:g}°"
    )
    table.caption_justify = "left"
    for number, changes in enumerate(hidden["segments"], start=1):
        shown = (
            "{} ({})".format(
                *(f"> {load_n:g}" if n is None else f"{n:.2f}" for n in both.values())
            )
            for both in (changes[when] for when in columns)
        )
        table.add_row(str(number), *shown)
    return table


_SHOWN_PLACES = 4


def describe_effect(effect: Effect) -> Description:
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


def _effect_table(effect: Description) -> Table:
    places = effect["places_of_four_segments_and_twelve_cables"]
    shown = places if len(places) <= _SHOWN_PLACES + 1 else [*places[:_SHOWN_PLACES], "…"]
    kind = ", a tolerance and no finding" if effect["tolerance"] else ""
    headings = ("parameter", "unit", "from", "to", "typical")
    table = titled_table(
        f"[bold]{effect['name']}[/bold]: {effect['about']}", *headings, right=headings[2:]
    )
    table.caption = (
        f"acts on: {effect['acts_on']}{kind}\nat: {', '.join(shown)}\n{effect['source']}"
    )
    table.caption_justify, table.expand = "left", True
    for column in table.columns:
        column.no_wrap = True
    table.add_column("what", ratio=1)
    for p in (*effect["parameters"], *effect["history_of_four_segments_and_twelve_cables"][:1]):
        numbers = (f"{p[key]:g}" for key in ("low", "high", "typical"))
        table.add_row(p["name"], _unit(p), *numbers, p["about"])
    return table
