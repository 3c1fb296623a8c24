"""The catalogue of effects, for `cablesense info --effects`."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from cablesense_sim.effects.effect import Effect, Parameter
from cablesense_sim.effects.registry import known_effects

Description = dict[str, Any]

_FOUR_SEGMENTS, _TWELVE_CABLES = 4, 12
_SHOWN_PLACES = 4


def describe_effects() -> Description:
    """All known effects, those of other packages too, as plain values.

    Raises:
        CableSenseError: another package offers what is no effect.
    """
    return {"kind": "effects", "effects": [_said(effect) for effect in known_effects().values()]}


def _said(effect: Effect) -> Description:
    return {
        "name": effect.name,
        "acts_on": effect.acts_on,
        "about": effect.about,
        "tolerance": effect.tolerance,
        "source": effect.source,
        "places_of_four_segments_and_twelve_cables": list(
            effect.places(_FOUR_SEGMENTS, _TWELVE_CABLES)
        ),
        "parameters": [_numbers(parameter) for parameter in effect.parameters],
        "history_of_four_segments_and_twelve_cables": [
            _numbers(parameter) for parameter in effect.history(_FOUR_SEGMENTS, _TWELVE_CABLES)
        ],
    }


def _numbers(parameter: Parameter) -> Description:
    return {
        "name": parameter.name,
        "unit": parameter.unit,
        "low": parameter.low,
        "high": parameter.high,
        "typical": parameter.typical,
        "default": parameter.default,
        "role": parameter.role,
        "about": parameter.about,
    }


def effect_tables(catalogue: Description) -> list[Table]:
    """One table an effect: what it is, and its parameters."""
    return [_table(effect) for effect in catalogue["effects"]]


def _table(effect: Description) -> Table:
    places = effect["places_of_four_segments_and_twelve_cables"]
    shown = places if len(places) <= _SHOWN_PLACES + 1 else [*places[:_SHOWN_PLACES], "…"]
    kind = ", a tolerance and no finding" if effect["tolerance"] else ""
    table = Table(
        title=f"[bold]{effect['name']}[/bold]: {effect['about']}",
        title_justify="left",
        caption=f"acts on: {effect['acts_on']}{kind}\nat: {', '.join(shown)}\n{effect['source']}",
        caption_justify="left",
        header_style="bold",
        expand=True,
    )
    table.add_column("parameter", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for heading in ("from", "to", "typical"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("what", ratio=1)
    for p in (*effect["parameters"], *effect["history_of_four_segments_and_twelve_cables"][:1]):
        table.add_row(
            p["name"],
            "" if p["unit"] == "1" else p["unit"],
            *(f"{p[key]:g}" for key in ("low", "high", "typical")),
            p["about"],
        )
    return table
