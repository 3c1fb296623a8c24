"""A calibration file: scale and zero of single cables' sensors, in place of the channel map's.

It names the map, signals and units it was made for, so that it cannot be applied to another one.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

import yaml
from cantools.database.can import Database
from pydantic import Field

from cablesense_base.files import read_bounded_text, write_atomically
from cablesense_base.plain_yaml import Count, FilePart, Number, read_plain
from cablesense_msgs_py.messages import Level, Status
from cablesense_online.can.channel_map import (
    MAX_CHANNELS,
    MAX_MAP_BYTES,
    ChannelMap,
    ChannelMapError,
    Name,
    Scale,
    Zero,
    signal_conversion,
)

_HEAD = """\
# Scale and zero of tension sensors, from known loads. Give it to the driver as -p calibration:=…
# tension_n = scale_n_per_unit * (value - zero); every *_u95 is an expanded uncertainty (95 %).
"""


class CalibratedSensor(FilePart):
    """One cable's sensor: `tension_n = scale_n_per_unit * (value - zero)`.

    The rest is its origin and uncertainty (expanded, 95 %); it may be left out in a file written
    by hand.

    Attributes:
        message, signal: the DBC file's place of the sensor's value.
        signal_unit, signal_factor, signal_offset: its conversion in the DBC file then.
        points, largest_force_n: how many known loads, up to where.
        tension_u95_n: of a tension up to there.
    """

    message: Name
    signal: Name
    signal_unit: Annotated[str, Field(max_length=32)]
    signal_factor: Number
    signal_offset: Number
    scale_n_per_unit: Scale
    zero: Zero
    scale_u95_n_per_unit: Number | None = None
    zero_u95: Number | None = None
    tension_u95_n: Number | None = None
    points: Count | None = None
    largest_force_n: Number | None = None
    nonlinearity_n: Number | None = None
    hysteresis_n: Number | None = None
    repeatability_n: Number | None = None


class Calibration(FilePart):
    """A whole file.

    Attributes:
        map: name of the channel map it belongs to.
        made: when.
        gravity_m_s2: with which masses were converted to forces, if they were.
        common_relative_u: relative standard uncertainty that all loads shared.
        uncalibrated: cables of the map that keep its scale and zero, by name.
        cables: the others.
    """

    map: Annotated[str, Field(max_length=64)]
    made: datetime
    gravity_m_s2: Number | None = None
    common_relative_u: Number | None = None
    uncalibrated: Annotated[tuple[Name, ...], Field(max_length=MAX_CHANNELS)] = ()
    cables: Annotated[dict[Name, CalibratedSensor], Field(min_length=1, max_length=MAX_CHANNELS)]


def calibrated(
    channel_map: ChannelMap, database: Database, calibration: Calibration, source: str
) -> ChannelMap:
    """The map with the calibration's scales and zeros; `source` names the calibration in errors.

    Raises:
        ChannelMapError: it was made for another map, for other signals or units, or leaves a
            cable out that it names neither as calibrated nor as uncalibrated.
    """
    if calibration.map != channel_map.name:
        raise ChannelMapError(
            f"{source}: was made for map {calibration.map}, not for {channel_map.name}; calibrate "
            "with the map that the driver uses"
        )
    named = [*calibration.cables, *calibration.uncalibrated]
    unknown = [cable for cable in named if cable not in channel_map.channels]
    twice = sorted({cable for cable in named if named.count(cable) > 1})
    silent = [cable for cable in channel_map.channels if cable not in named]
    for cables, text in (
        (unknown, f"has {{}}, which map {channel_map.name} has not"),
        (twice, "names {} twice; a cable is calibrated or uncalibrated"),
        (
            silent,
            "leaves out {}; name them under uncalibrated, if they are to keep the map's scale and "
            "zero",
        ),
    ):
        if cables:
            raise ChannelMapError(f"{source}: {text.format(', '.join(cables))}")
    channels = dict(channel_map.channels)
    for cable, sensor in calibration.cables.items():
        channel = channels[cable]
        text = "{}.{} in {!r}, factor {:g}, offset {:g}"
        now = (channel.message, channel.signal, *signal_conversion(database, channel))
        then = (
            *(sensor.message, sensor.signal, sensor.signal_unit),
            *(sensor.signal_factor, sensor.signal_offset),
        )
        if then != now:
            raise ChannelMapError(
                f"{source}: {cable} was calibrated as {text.format(*then)}; map and DBC file now "
                f"give it {text.format(*now)}: calibrate it anew"
            )
        update = {"scale_n_per_unit": sensor.scale_n_per_unit, "zero": sensor.zero}
        channels[cable] = channel.model_copy(update=update)
    return channel_map.model_copy(update={"channels": channels})


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration.

    Raises:
        ChannelMapError: the file cannot be read, is not YAML, or has a key or value that
            cannot be.
    """
    text = read_bounded_text(path, MAX_MAP_BYTES, "a calibration", ChannelMapError)
    return read_plain(text, str(path), Calibration, ChannelMapError)


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration.

    Raises:
        ChannelMapError: the place cannot be written to.
    """
    content = calibration.model_dump(mode="json", exclude_none=True)
    text = _HEAD + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
    write_atomically(path, text, ChannelMapError)


def calibration_status(calibration: Calibration | None) -> Status:
    """Where scales and zeros are from; of calibrated cables also their values, for the record."""
    if calibration is None:
        return Status("calibration", Level.OK, "none given; those of the channel map")
    values = {
        cable: f"{sensor.scale_n_per_unit:.6g} N per unit from zero {sensor.zero:.6g}"
        for cable, sensor in calibration.cables.items()
    }
    made = f"calibration of {calibration.made:%Y-%m-%d %H:%M}"
    if calibration.uncalibrated:
        left = ", ".join(calibration.uncalibrated)
        return Status("calibration", Level.WARN, f"{made}, but the map's for {left}", values)
    return Status("calibration", Level.OK, made, values)
