"""Channel map, DBC file and sensor scales: which signal is which cable, with its scale and zero.

Maps are YAML files, the bundled ones opened by name and any other by path. cantools reads the DBC
file (Vector's text format) that a map names. A file of sensor scales, as `cablesense sensors
calibrate` writes it, replaces the scale and zero of some cables. It names the map, signals and
units it was made for, so no other map takes it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime
from math import isfinite
from pathlib import Path
from typing import Annotated

import cantools
import yaml
from cantools.database.can import Database, Signal
from pydantic import AfterValidator, Field, model_validator

from cablesense_base import CableSenseError, some_of
from cablesense_base.files import read_bounded_text, write_atomically
from cablesense_base.installation import BundledFiles
from cablesense_base.plain_yaml import Count, FilePart, Number, read_plain
from cablesense_msgs_py.messages import Level, Status
from cablesense_recording.units import FORCE_UNITS

MAX_MAP_BYTES = 200_000
"""A map or a file of scales is a page of text."""
_MAX_DBC_BYTES = 2_000_000
"""The DBC file of a whole car has about a megabyte."""
_DBC_ENCODING = "cp1252"
"""Of DBC files that are not UTF-8: the tools that write them are of Windows."""
_SIZES = re.compile(r"(?m)^\s*(?:BO_[^:\n]*:\s*(\d+)|SG_[^:\n]*:\s*(\d+)\s*\|\s*(\d+))")
_LARGEST_SIZE = 8 * 1785
"""The bits of J1939's longest message. cantools takes memory for every bit that a line claims."""
_HAS_BIG_ENDIAN = re.compile(r"(?m)^\s*SG_[^:\n]*:\s*\d+\s*\|\s*\d+\s*@\s*0")
_BIG_ENDIAN = (
    "a big-endian signal (@0) starts at its highest bit, which is 7 in byte 0, 15 in byte 1, 23 "
    "in byte 2 and so on"
)
_SCALES_HEAD = """\
# Scale and zero of tension sensors, from known loads. Give it to the driver as
# -p sensor_calibration_file:=…
# tension_n = scale_n_per_unit * (value - zero); every *_u95 is an expanded uncertainty (95 %).
"""


class ChannelMapError(CableSenseError):
    """A channel map, DBC file or sensor scales that do not fit: names file, place and remedy."""


def _not_zero(scale_n_per_unit: float) -> float:
    if scale_n_per_unit == 0.0:
        raise ValueError(
            "= 0, so every reading is 0 N; it must be the newtons of one unit of the signal "
            "(negative if the signal falls under tension)"
        )
    return scale_n_per_unit


Mask = Annotated[Count, Field(ge=0, le=0xFFFF)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]{0,127}$")]
"""A DBC identifier."""
Scale = Annotated[Number, Field(ge=-1e9, le=1e9), AfterValidator(_not_zero)]
"""The bounds of scale and zero cover any plausible amplifier and reveal a wrong unit."""
Zero = Annotated[Number, Field(ge=-1e12, le=1e12)]


class SignalPlace(FilePart):
    """A signal of the DBC file."""

    message: Name
    signal: Name


class Channel(SignalPlace):
    """The signal of one cable: `tension_n = scale_n_per_unit * (value - zero)`.

    `value` and `zero` have the unit that the DBC file gives the signal. Where that is another than
    N, the map must state `scale_n_per_unit` (`check_fit`). `status` names a signal of the same
    message whose bits `status_masks` of the map interprets.
    """

    status: Name | None = None
    scale_n_per_unit: Scale = 1.0
    zero: Zero = 0.0

    def tension_n(self, value: float) -> float:
        """The tension in N of a signal's value."""
        return self.scale_n_per_unit * (value - self.zero)

    def value(self, tension_n: float) -> float:
        """The signal's value of a tension in N."""
        return tension_n / self.scale_n_per_unit + self.zero


class StatusMasks(FilePart):
    """Bits of the status signals. A reading is invalid if its status has one of them set."""

    invalid: Mask = 0
    over_range: Mask = 0
    under_range: Mask = 0


class StuckLimits(FilePart):
    """When a reading that stays the same to the last bit counts as stuck.

    It has, for `after_s` at least, while half of the others moved by `others_moved_n` at least.
    """

    after_s: Annotated[Number, Field(ge=0.01, le=3600.0)]
    others_moved_n: Annotated[Number, Field(gt=0.0, le=1e5)]


class ChannelMap(FilePart):
    """The whole map.

    Attributes:
        dbc: path of the DBC file, relative to the map.
        cycle_time_s: time from one sample to the next.
        skew_limit_s: maximum time from the first to the last frame of one sample.
        flood_frames_s: rate of frames, of any id, above which the bus counts as flooded.
        range_n: lowest and highest tension; a reading at or beyond either is invalid.
        counter: the signal that counts cycles, in the message that opens each; or none.
        nmt_start_nodes: CANopen nodes that send only after an NMT start (CiA 301).
        channels: the signal of each cable, by the cable's name.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]{1,64}$")]
    dbc: str
    cycle_time_s: Annotated[Number, Field(ge=1e-4, le=1.0)]
    skew_limit_s: Annotated[Number, Field(gt=0.0, le=1.0)]
    flood_frames_s: Annotated[Number, Field(ge=1.0, le=1e6)]
    range_n: tuple[Number, Number]
    stuck: StuckLimits
    status_masks: StatusMasks = StatusMasks()
    counter: SignalPlace | None = None
    nmt_start_nodes: tuple[Annotated[Count, Field(ge=1, le=127)], ...] = ()
    channels: Annotated[dict[Name, Channel], Field(min_length=1)]

    @property
    def cable_names(self) -> tuple[str, ...]:
        """Names of the cables in the map's order."""
        return tuple(self.channels)

    @property
    def message_names(self) -> set[str]:
        """Names of the messages that make one sample, including the counter's."""
        counter = {self.counter.message} if self.counter else set()
        return counter | {channel.message for channel in self.channels.values()}

    def arranged(self, cable_names: Sequence[str]) -> ChannelMap:
        """The map with its channels in an arm's order.

        Raises:
            ChannelMapError: a cable has no channel, or a channel no cable.
        """
        missing = [name for name in cable_names if name not in self.channels]
        unknown = [name for name in self.channels if name not in cable_names]
        if missing or unknown:
            raise ChannelMapError(
                f"map {self.name} lacks {', '.join(missing) or 'no cable'} and has "
                f"{', '.join(unknown) or 'none'} that the arm has not; each cable needs a channel"
            )
        channels = {name: self.channels[name] for name in cable_names}
        return self.model_copy(update={"channels": channels})

    @model_validator(mode="after")
    def _is_possible(self) -> ChannelMap:
        if self.skew_limit_s > self.cycle_time_s:
            raise ValueError(
                f"gives skew_limit_s = {self.skew_limit_s:g}; it must be at most cycle_time_s = "
                f"{self.cycle_time_s:g}, or frames of two cycles would make one sample"
            )
        if self.range_n[0] >= self.range_n[1]:
            raise ValueError(
                f"gives range_n = {list(self.range_n)}; it must be [lowest, highest] in N"
            )
        by_signal: dict[tuple[str, str], str] = {}
        for cable, channel in self.channels.items():
            other = by_signal.setdefault((channel.message, channel.signal), cable)
            if other != cable:
                raise ValueError(
                    f"gives {other} and {cable} the same signal {channel.message}."
                    f"{channel.signal}; every cable has its own sensor"
                )
        return self


_BUNDLED = BundledFiles("channel map", "can", (".yaml", ".yml"), ChannelMapError)


def open_channel_map(name_or_path: str | Path) -> tuple[ChannelMap, Database]:
    """A map by name (`cia404_amplifier`) or path (`my/map.yaml`), with its DBC file.

    Raises:
        ChannelMapError: a file is missing or unreadable, has an impossible key or value, or the
            two do not fit each other.
    """
    path = _BUNDLED.find(name_or_path)
    text = read_bounded_text(path, MAX_MAP_BYTES, "a channel map", ChannelMapError)
    channel_map = read_plain(text, str(path), ChannelMap, ChannelMapError)
    dbc = path.parent / channel_map.dbc
    text = read_bounded_text(dbc, _MAX_DBC_BYTES, "a DBC file", ChannelMapError, _DBC_ENCODING)
    database = parse_database(text, source=str(dbc))
    check_fit(channel_map, database, source=str(dbc))
    return channel_map, database


def parse_database(text: str, source: str = "DBC file") -> Database:
    """Read DBC text; `source` names it in errors.

    Raises:
        ChannelMapError: not DBC, or signals that overlap or exceed their message.
    """
    for size_match in _SIZES.finditer(text):
        if any(len(size) > 5 or int(size) > _LARGEST_SIZE for size in size_match.groups("0")):
            raise ChannelMapError(
                f"{source}: {size_match[0].strip()[:60]!r} is larger than any message on a CAN bus"
            )
    try:
        database = cantools.database.load_string(text, database_format="dbc", strict=True)
    except Exception as error:  # the parser raises errors of many kinds
        line = " ".join(str(error).split())[:300] or type(error).__name__
        hint = (
            f"; {_BIG_ENDIAN}" if "does not fit" in line and _HAS_BIG_ENDIAN.search(text) else ""
        )
        raise ChannelMapError(
            f"{source}: not a valid DBC file ({line}); no signal may exceed its message or "
            f"overlap another{hint}"
        ) from error
    if not isinstance(database, Database) or not database.messages:
        raise ChannelMapError(f"{source}: holds no messages; a DBC file has a BO_ line for each")
    return database


def check_fit(channel_map: ChannelMap, database: Database, source: str = "DBC file") -> None:
    """Check that every message and signal that the map names exists and can be read.

    Raises:
        ChannelMapError: names the cable, the missing or unfit signal, and the existing ones; or
            the unit of a signal for which the map gives no scale.
    """
    for cable, channel in channel_map.channels.items():
        where = f"{source}: channel {cable}"
        unit = (_signal_of(database, channel, where).unit or "").strip()
        if unit not in ("", "N") and "scale_n_per_unit" not in channel.model_fields_set:
            newtons = f": {FORCE_UNITS[unit]:.7g}" if unit in FORCE_UNITS else ""
            raise ChannelMapError(
                f"{where}: {channel.signal} is in {unit[:40]!r}, not in N, and map "
                f"{channel_map.name} gives no scale; state its scale_n_per_unit{newtons}, the "
                "newtons of one such unit"
            )
        if channel.status is not None:
            status_place = SignalPlace(message=channel.message, signal=channel.status)
            if _signal_of(database, status_place, where).is_float:
                raise ChannelMapError(
                    f"{where}: status {status_place.signal} must be a whole number"
                )
    if channel_map.counter is not None:
        where = f"{source}: counter"
        counter = _signal_of(database, channel_map.counter, where)
        if counter.is_float or counter.is_signed or counter.length < 2:
            raise ChannelMapError(
                f"{where}: {counter.name} must be an unsigned whole number of two bits or more, "
                "so that a lost cycle shows"
            )


def signal_conversion(database: Database, place: SignalPlace) -> tuple[str, float, float]:
    """Unit, factor and offset of a signal by the DBC file: `value = factor * bits + offset`.

    Raises:
        ChannelMapError: the database lacks its message or signal.
    """
    signal = _signal_of(database, place, "DBC file")
    return signal.unit or "", float(signal.scale), float(signal.offset)


def _signal_of(database: Database, place: SignalPlace, where: str) -> Signal:
    messages = {message.name: message for message in database.messages}
    message = messages.get(place.message)
    if message is None:
        known = some_of(list(messages))
        raise ChannelMapError(f"{where}: no message {place.message}; there are {known}")
    if message.is_multiplexed() or message.is_fd or message.is_container:
        raise ChannelMapError(
            f"{where}: message {place.message} is multiplexed, a container or CAN FD; it must be "
            "a plain message of at most 8 bytes"
        )
    signals = {signal.name: signal for signal in message.signals}
    signal = signals.get(place.signal)
    if signal is None:
        known = some_of(list(signals)) or "none"
        raise ChannelMapError(
            f"{where}: no signal {place.signal} in message {place.message}; there are {known}"
        )
    if not (isfinite(signal.scale) and isfinite(signal.offset)):
        raise ChannelMapError(f"{where}: factor or offset of {place.signal} is not finite")
    return signal


class ScaledSensor(SignalPlace):
    """The sensor of one cable: `tension_n = scale_n_per_unit * (value - zero)`.

    The optional fields record origin and expanded uncertainty (95 %).

    Attributes:
        signal_unit, signal_factor, signal_offset: its conversion in the DBC file at that time.
        points, largest_force_n: number of known loads, and the largest.
        tension_u95_n: largest uncertainty of a tension within the range of the loads.
        nonlinearity_n: largest distance of a rising load's mean reading from the line.
        hysteresis_n: largest difference of mean readings between falling and rising at one load;
            none if the loads do not show it.
        repeatability_n: largest range of readings at one load, reached from one side; or none.
    """

    signal_unit: str
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


class SensorScales(FilePart):
    """A file with scales and zeros of sensors, as `cablesense sensors calibrate` writes it.

    Attributes:
        map: name of the channel map it belongs to.
        gravity_m_s2: the value that converted masses to forces, if there were masses.
        common_relative_u: relative standard uncertainty that all loads shared.
        uncalibrated: names of the cables that keep the map's scale and zero.
    """

    map: str
    made: datetime
    gravity_m_s2: Number | None = None
    common_relative_u: Number | None = None
    uncalibrated: tuple[Name, ...] = ()
    cables: Annotated[dict[Name, ScaledSensor], Field(min_length=1)]


def with_sensor_scales(
    channel_map: ChannelMap, database: Database, scales: SensorScales, source: str
) -> ChannelMap:
    """The map with these scales and zeros; `source` names their file in errors.

    Raises:
        ChannelMapError: it was made for another map, for other signals or units, or does not
            name every cable of the map once, as calibrated or as uncalibrated.
    """
    if scales.map != channel_map.name:
        raise ChannelMapError(
            f"{source}: was made for map {scales.map}, not for {channel_map.name}; calibrate "
            "with the map that the driver uses"
        )
    named = [*scales.cables, *scales.uncalibrated]
    differing = {c for c in {*named, *channel_map.channels} if named.count(c) != 1}
    differing |= set(named) - set(channel_map.channels)
    if differing:
        raise ChannelMapError(
            f"{source}: {', '.join(sorted(differing))}: every cable of map {channel_map.name}, "
            "and no other, must stand once under cables or uncalibrated"
        )
    channels = dict(channel_map.channels)
    for cable, sensor in scales.cables.items():
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
                f"give it {text.format(*now)}; calibrate it again"
            )
        update = {"scale_n_per_unit": sensor.scale_n_per_unit, "zero": sensor.zero}
        channels[cable] = channel.model_copy(update=update)
    return channel_map.model_copy(update={"channels": channels})


def load_sensor_scales(path: str | Path) -> SensorScales:
    """Read scales and zeros of sensors, as `write_sensor_scales` writes them.

    Raises:
        ChannelMapError: the file cannot be read, is not YAML, or has an impossible key or value.
    """
    text = read_bounded_text(path, MAX_MAP_BYTES, "a calibration", ChannelMapError)
    return read_plain(text, str(path), SensorScales, ChannelMapError)


def write_sensor_scales(path: str | Path, scales: SensorScales) -> None:
    """Write scales and zeros of sensors.

    Raises:
        ChannelMapError: the file cannot be written.
    """
    content = scales.model_dump(mode="json", exclude_none=True)
    text = _SCALES_HEAD + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
    write_atomically(path, text, ChannelMapError)


def sensor_scales_status(scales: SensorScales | None) -> Status:
    """The origin of scales and zeros, and their values, for diagnostics."""
    if scales is None:
        return Status("calibration", Level.OK, "none given; those of the channel map")
    values = {
        cable: f"{sensor.scale_n_per_unit:.6g} N per unit from zero {sensor.zero:.6g}"
        for cable, sensor in scales.cables.items()
    }
    message = f"calibration of {scales.made:%Y-%m-%d %H:%M}"
    uncalibrated = scales.uncalibrated
    if uncalibrated:
        message += f", but the map's for {', '.join(uncalibrated)}"
    return Status("calibration", Level.WARN if uncalibrated else Level.OK, message, values)
