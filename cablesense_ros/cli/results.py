"""Results of the verbs: JSON for programs, or the same as tables for people."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

_LISTED = 16
"""Numbers of a longer list are shown by its first and last."""


def print_json(content: Any) -> None:
    """Print a result for machines."""
    print(json.dumps(content, indent=2))


def print_result(title: str, content: Mapping[str, Any], as_json: bool) -> None:
    """Print plain values: as JSON, or as tables whose headings are the keys.

    Keys carry the units. A collection of mappings becomes a table with a row for each.
    """
    if as_json:
        print_json(content)
        return
    for table in _tables(title, content):
        Console().print(table)


def titled_table(
    title: str, *headings: str, right: Iterable[str] = (), rows: Iterable[Sequence[str]] = ()
) -> Table:
    """A table, its title and columns to the left; those in `right` to the right."""
    table = Table(
        title=title, title_justify="left", header_style="bold", show_header=bool(headings)
    )
    for heading in headings:
        table.add_column(heading, justify="right" if heading in right else "left")
    for row in rows:
        table.add_row(*row)
    return table


def _tables(title: str, content: Mapping[Any, Any]) -> Iterator[Table]:
    plain, nested = _parted(content)
    if plain and all(isinstance(value, Mapping) for value in content.values()):
        plain, nested = {}, dict(content)
    if plain:
        table = Table(title=title, title_justify="left", show_header=False)
        table.add_column(style="bold")
        table.add_column(overflow="fold")
        for name, value in plain.items():
            if value != []:
                table.add_row(str(name), _shown(value))
        yield table
    if nested and all(isinstance(value, Mapping) for value in content.values()):
        parted = {name: _parted(value) for name, value in nested.items()}
        headings = list(dict.fromkeys(key for cells, _ in parted.values() for key in cells))
        rows = [
            (str(name), *(_shown(cells.get(key, "")) for key in headings))
            for name, (cells, _) in parted.items()
        ]
        if headings:
            yield titled_table(title, "", *headings, rows=rows)
        nested = {f"{name}, {k}": v for name, (_, rest) in parted.items() for k, v in rest.items()}
    for name, value in nested.items():
        entries = value if isinstance(value, Mapping) else dict(enumerate(value, start=1))
        yield from _tables(f"{title}: {name}", entries)


def _parted(content: Mapping[Any, Any]) -> tuple[dict[Any, Any], dict[Any, Any]]:
    """The values that one line can hold, and the others."""
    plain = {name: value for name, value in content.items() if _fits_a_line(value)}
    return plain, {name: value for name, value in content.items() if name not in plain}


def _fits_a_line(value: Any) -> bool:
    within = value.values() if isinstance(value, Mapping) else value
    if isinstance(value, Mapping | list | tuple):
        return not any(isinstance(each, Mapping | list | tuple) for each in within)
    return True


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_shown(each)}" for name, each in value.items())
    if isinstance(value, list | tuple):
        if len(value) > 1 and len(set(value)) == 1:
            return f"{_shown(value[0])} each"
        if len(value) > _LISTED:
            return f"{_shown(value[0])} … {_shown(value[-1])}"
        return ", ".join(map(_shown, value))
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
