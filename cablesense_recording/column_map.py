"""The columns of somebody else's recording: which hold what of a machine, and in which units.

A YAML file names them (docs/recordings.md, Columns of your own). Whatever it leaves out has the
name that a recording of ours has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from cablesense_base import Array, some_of
from cablesense_base.files import read_bounded_text
from cablesense_base.plain_yaml import FilePart, Number, read_plain
from cablesense_recording.channels import LOAD, LOAD_AT, LOAD_SEGMENT, TIME
from cablesense_recording.layout import Described, Layout, layout_of
from cablesense_recording.recording import RecordingError
from cablesense_recording.units import (
    COMMAND_UNITS,
    FORCE_UNITS,
    LENGTH_UNITS,
    READING_UNITS,
    TIME_UNITS,
)

MAX_FILE_BYTES = 100_000


class TimeColumn(FilePart):
    """The time of a CSV file; a bag has its messages'."""

    column: str = TIME
    unit: str = "s"


class NamedColumns(FilePart):
    """The channels of all readings, or of all numbers of a command.

    Attributes:
        columns: their names, in the machine's order; of an arm's joints pitch, then yaw.
        unit: of the numbers.
        scale: the numbers are multiplied by it too; -1 turns signs.
        offset: what is added then, in `unit`: to all of them, or one for each.
        topic: of a bag, the messages that hold them: `sensor_msgs/JointState`, or one with `data`.
        field: of such a `JointState`.
        held: in place of columns: the values that hold all the time.
    """

    columns: tuple[str, ...] = ()
    unit: str = ""
    scale: Number = 1.0
    offset: Number | tuple[Number, ...] = 0.0
    topic: str = ""
    field: Literal["position", "velocity", "effort", "data", ""] = ""
    held: tuple[Number, ...] = ()

    @model_validator(mode="after")
    def _one_source(self) -> NamedColumns:
        if self.held and (self.columns or self.topic):
            raise ValueError("= held: the values that hold all the time leave no columns or topic")
        return self

    def in_si(self, recorded: Array, per_unit: float) -> Array:
        """Recorded numbers (..., K) in SI units, of which one unit is so much."""
        return np.asarray(per_unit * (self.scale * recorded + np.array(self.offset)))


class Loads(FilePart):
    """Known loads, which a diagnosis needs.

    Attributes:
        segment: the column of the segment, 0 without a load. Where only one link may be touched a
            file may lack it: that link is loaded.
        least: a smaller force, N, is none there: a force sensor is never quite at zero.
        force: the columns of the load's components, base frame.
        unit: of these.
        at: the column of the place on the segment; empty where all act at its contact point.
        at_unit: of this.
    """

    segment: str = LOAD_SEGMENT
    least: Annotated[Number, Field(ge=0.0)] = 0.0
    force: tuple[str, str, str] = LOAD
    unit: str = "N"
    at: str = ""
    at_unit: str = "m"


class ColumnMap(FilePart):
    """All that a recording's columns mean.

    Attributes:
        trial: the column of the trial; empty where there is none, and trials are derived.
        loads: None where no load is known.
    """

    time: TimeColumn = TimeColumn()
    tensions: NamedColumns = NamedColumns()
    commands: NamedColumns = NamedColumns()
    trial: str = ""
    loads: Loads | None = None

    def tension_columns(self, layout: Layout) -> Sequence[str]:
        """The columns of the machine's M channels."""
        return self.tensions.columns or layout.reading_columns

    def command_columns(self, layout: Layout) -> Sequence[str]:
        """The columns of the C numbers of a command."""
        return self.commands.columns or layout.command_columns

    @property
    def with_loads(self) -> ColumnMap:
        """The same with known loads, in columns of our names where the map has none."""
        return self if self.loads else self.model_copy(update={"loads": Loads(at=LOAD_AT)})

    @property
    def unloaded(self) -> ColumnMap:
        """The same without loads and trials."""
        return self.model_copy(update={"trial": "", "loads": None})

    def readings(self, recorded: Array) -> Array:
        """Recorded numbers (..., M) of the channels, in N, or N·m of torques."""
        return self.tensions.in_si(recorded, READING_UNITS[self.tensions.unit or "N"])

    def commanded(self, recorded: Array) -> Array:
        """Recorded numbers (..., C) of commands, in rad, or m of lengths."""
        return self.commands.in_si(recorded, COMMAND_UNITS[self.commands.unit or "rad"])

    @property
    def seconds(self) -> float:
        """What one unit of time is, s."""
        return TIME_UNITS[self.time.unit]


def read_column_map(path: str | Path, machine: Described) -> ColumnMap:
    """The map in a YAML file, for a machine.

    Raises:
        RecordingError: unreadable, an unknown key or unit, or not as many columns as the machine
            has channels or numbers in a command.
    """
    layout = layout_of(machine)
    text = read_bounded_text(path, MAX_FILE_BYTES, "a map of columns (.yaml)", RecordingError)
    described = read_plain(text, str(path), ColumnMap, RecordingError)
    _require_unit(path, "tensions.unit", described.tensions.unit, layout.reading_units)
    _require_unit(path, "commands.unit", described.commands.unit, layout.command_units)
    _require_unit(path, "time.unit", described.time.unit, TIME_UNITS)
    if described.loads is not None:
        _require_unit(path, "loads.unit", described.loads.unit, FORCE_UNITS)
        _require_unit(path, "loads.at_unit", described.loads.at_unit, LENGTH_UNITS)
    tensions = described.tensions
    commands = described.commands
    owner = layout.name
    _require_count(path, "tensions.columns", tensions.columns, layout.channel_names, owner)
    _require_count(path, "commands.columns", commands.columns, layout.command_names, owner)
    _require_count(path, "commands.held", commands.held, layout.command_names, owner)
    for key, channels, names in (
        ("tensions.offset", tensions, layout.channel_names),
        ("commands.offset", commands, layout.command_names),
    ):
        if isinstance(channels.offset, tuple):
            _require_count(path, key, channels.offset, names, owner)
    if described.tensions.held:
        raise RecordingError(f"{path}: tensions.held: readings are never constant; name columns")
    return described


def _require_unit(path: str | Path, key: str, unit: str, units: Mapping[str, float]) -> None:
    if unit and unit not in units:
        raise RecordingError(
            f"{path}: {key} = {unit[:40]!r}: must be one of {', '.join(units)}; any other is one "
            "of these times a scale"
        )


def _require_count(
    path: str | Path, key: str, given: Sequence[object], names: Sequence[str], owner: str
) -> None:
    if given and len(given) != len(names):
        raise RecordingError(
            f"{path}: {key} has {len(given)} entries; {owner} needs {len(names)}, in the "
            f"order {some_of(names, 4)}"
        )
    repeated = [each for each in given if isinstance(each, str) and given.count(each) > 1]
    if repeated:
        raise RecordingError(f"{path}: {key} names {repeated[0][:40]!r} twice; once is right")
