"""The channel map: which signal of a DBC file is which cable, and which readings are valid.

Maps are YAML files, bundled ones by name and any other by path; bounds on their numbers are those
of any plausible amplifier, to catch a wrong unit. The DBC file beside a map (Vector's text format)
is read by cantools; its sizes are bounded before, since cantools takes memory for every bit of a
message before it compares a signal with its message.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import cantools
from cantools.database.can import Database, Message, Signal
from pydantic import AfterValidator, Field, model_validator

from cablesense_base import CableSenseError, some_of
from cablesense_base.files import read_bounded_text
from cablesense_base.installation import BundledFiles
from cablesense_base.plain_yaml import Count, FilePart, Number, read_plain

MAX_CHANNELS = 256
MAX_MAP_BYTES = 200_000
"""A map is a page of text."""
_MAX_DBC_BYTES = 2_000_000
"""A car's whole DBC file is a megabyte."""
_MOST_BYTES = 1785
"""Of the longest message that travels over CAN: that of J1939's transport protocol."""
_MOST_SIGNAL_BITS = 64
_LARGEST_FACTOR = 1e30


class ChannelMapError(CableSenseError):
    """A channel map, DBC or calibration file that does not fit: names which, where, what would."""


def _not_zero(scale_n_per_unit: float) -> float:
    if scale_n_per_unit == 0.0:
        raise ValueError(
            "= 0, so that every reading is 0 N; it must be the newtons of one unit of the signal "
            "(negative if it falls under tension)"
        )
    return scale_n_per_unit


Mask = Annotated[Count, Field(ge=0, le=0xFFFF)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]{0,127}$")]
"""A DBC identifier."""
Scale = Annotated[Number, Field(ge=-1e9, le=1e9), AfterValidator(_not_zero)]
Zero = Annotated[Number, Field(ge=-1e12, le=1e12)]


class Channel(FilePart):
    """One cable's signal: `tension_n = scale_n_per_unit * (value - zero)`.

    `value` and `zero` are in the unit that the DBC file gives the signal. `status` names a signal
    of the same message, which `status_masks` of the map read.
    """

    message: Name
    signal: Name
    status: Name | None = None
    scale_n_per_unit: Scale = 1.0
    zero: Zero = 0.0

    def tension_n(self, value: float) -> float:
        """The tension in N of a signal's value."""
        return self.scale_n_per_unit * (value - self.zero)

    def value(self, tension_n: float) -> float:
        """The signal's value of a tension in N."""
        return tension_n / self.scale_n_per_unit + self.zero


class CounterSignal(FilePart):
    """The signal that counts cycles, in a message that opens each cycle."""

    message: Name
    signal: Name


class StatusMasks(FilePart):
    """Bits of the status signals; a reading whose status has one of them set is invalid."""

    invalid: Mask = 0
    over_range: Mask = 0
    under_range: Mask = 0


class StuckLimits(FilePart):
    """When a reading that stays the same to the last bit counts as stuck.

    Attributes:
        after_s: for so long it must have stayed the same,
        others_moved_n: while half of the other channels moved by more than this.
    """

    after_s: Annotated[Number, Field(ge=0.01, le=3600.0)]
    others_moved_n: Annotated[Number, Field(gt=0.0, le=1e5)]


class ChannelMap(FilePart):
    """The whole map; `channels` go by cable name.

    Attributes:
        dbc: file name, beside the map.
        cycle_time_s: from one sample to the next.
        skew_limit_s: from the first to the last frame of one sample.
        flood_frames_s: rate of frames, of any id, from which on the bus counts as flooded.
        range_n: lowest and highest tension; at or beyond either a reading is invalid.
        counter: the message that opens a cycle and counts it, if the amplifier sends one.
        nmt_start_nodes: CANopen nodes that send only after an NMT start (CiA 301).
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]{1,64}$")]
    dbc: Annotated[str, Field(max_length=128)]
    cycle_time_s: Annotated[Number, Field(ge=1e-4, le=1.0)]
    skew_limit_s: Annotated[Number, Field(gt=0.0, le=1.0)]
    flood_frames_s: Annotated[Number, Field(ge=1.0, le=1e6)]
    range_n: tuple[Number, Number]
    stuck: StuckLimits
    status_masks: StatusMasks = StatusMasks()
    counter: CounterSignal | None = None
    nmt_start_nodes: Annotated[
        tuple[Annotated[Count, Field(ge=1, le=127)], ...], Field(max_length=127)
    ] = ()
    channels: Annotated[dict[Name, Channel], Field(min_length=1, max_length=MAX_CHANNELS)]

    @property
    def cable_names(self) -> tuple[str, ...]:
        """In the order of the map."""
        return tuple(self.channels)

    @property
    def message_names(self) -> set[str]:
        """Of the messages that make one sample, the counter's included."""
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
            parts = [f"lacks {', '.join(missing)}"] if missing else []
            parts += [f"has {', '.join(unknown)}, which the arm has not"] if unknown else []
            raise ChannelMapError(
                f"map {self.name} {' and '.join(parts)}; the cables of this arm are "
                f"{cable_names[0]} … {cable_names[-1]}, each with one channel"
            )
        channels = {name: self.channels[name] for name in cable_names}
        return self.model_copy(update={"channels": channels})

    @model_validator(mode="after")
    def _is_possible(self) -> ChannelMap:
        for wrong, text in (
            (
                not self.dbc.endswith(".dbc") or "/" in self.dbc or "\\" in self.dbc,
                f"dbc = {self.dbc!r}; it must be the name of a .dbc file beside the map",
            ),
            (
                self.skew_limit_s > self.cycle_time_s,
                f"skew_limit_s = {self.skew_limit_s:g}; it must be at most cycle_time_s = "
                f"{self.cycle_time_s:g}, or frames of two cycles would make one sample",
            ),
            (
                self.range_n[0] >= self.range_n[1],
                f"range_n = {list(self.range_n)}; it must be [lowest, highest] in N",
            ),
        ):
            if wrong:
                raise ValueError(f"gives {text}")
        by_signal: dict[tuple[str, str], str] = {}
        for cable, channel in self.channels.items():
            other = by_signal.setdefault((channel.message, channel.signal), cable)
            if other != cable:
                raise ValueError(
                    f"gives {other} and {cable} the same signal {channel.message}."
                    f"{channel.signal}; every cable has a sensor of its own"
                )
        return self


_BUNDLED = BundledFiles("channel map", "can", (".yaml", ".yml"), ChannelMapError)


def open_channel_map(name_or_path: str | Path) -> tuple[ChannelMap, Database]:
    """A map by name (`cia404_amplifier`) or path (`my/map.yaml`), and the DBC file beside it.

    Raises:
        ChannelMapError: neither a bundled map nor a file; either file cannot be read, is no YAML
            or DBC, or has a key or value that cannot be true; or they do not fit.
    """
    path = _BUNDLED.find(name_or_path)
    text = read_bounded_text(path, MAX_MAP_BYTES, "a channel map", ChannelMapError)
    channel_map = read_plain(text, str(path), ChannelMap, ChannelMapError)
    beside = path.parent / channel_map.dbc
    text = read_bounded_text(beside, _MAX_DBC_BYTES, "a DBC file", ChannelMapError)
    database = parse_database(text, source=str(beside))
    check_fit(channel_map, database, source=str(beside))
    return channel_map, database


def parse_database(text: str, source: str = "DBC file") -> Database:
    """Read DBC text; `source` names it in errors.

    Raises:
        ChannelMapError: not DBC, or signals that overlap or leave their message.
    """
    _require_bounded_sizes(text, source)
    try:
        database = cantools.database.load_string(text, database_format="dbc", strict=True)
    except Exception as error:  # the parser raises whatever a broken file trips it over
        line = " ".join(str(error).split())[:300] or type(error).__name__
        raise ChannelMapError(
            f"{source}: not a DBC file that can be used ({line}); no signal may leave its message "
            "or lie over another"
        ) from error
    if not isinstance(database, Database) or not database.messages:
        raise ChannelMapError(f"{source}: holds no messages; a DBC file has a BO_ line for each")
    return database


def check_fit(channel_map: ChannelMap, database: Database, source: str = "DBC file") -> None:
    """Check that every message and signal that the map names is there and can be read.

    Raises:
        ChannelMapError: names the cable, what it asks for, and what there is.
    """
    for cable, channel in channel_map.channels.items():
        where = f"{source}: channel {cable}"
        _signal_of(database, channel.message, channel.signal, where)
        if channel.status is not None:
            status = _signal_of(database, channel.message, channel.status, where)
            if status.is_float:
                raise ChannelMapError(
                    f"{where}: status {channel.status} is a floating value; it must be of whole "
                    "bits"
                )
    if channel_map.counter is not None:
        where = f"{source}: counter"
        counter = _signal_of(
            database, channel_map.counter.message, channel_map.counter.signal, where
        )
        if counter.is_float or counter.is_signed or counter.length < 2:
            raise ChannelMapError(
                f"{where}: {counter.name} must be an unsigned whole number of two bits or more, "
                "so that a lost cycle shows"
            )


def signal_conversion(database: Database, channel: Channel) -> tuple[str, float, float]:
    """Unit, factor and offset of a channel by the DBC file: `value = factor * bits + offset`.

    Raises:
        ChannelMapError: the database lacks its message or signal.
    """
    signal = _signal_of(database, channel.message, channel.signal, "DBC file")
    return signal.unit or "", float(signal.scale), float(signal.offset)


_TOKEN = re.compile(
    r'"(?:\\"|[^"])*"|(?P<comment>//.*)|(?P<number>\d+)|(?P<sign>[:|@])|\w+|[^\s\w]'
)
_LIMITS = {
    (":", None): (_MOST_BYTES, "a message of bytes"),
    (":", "|"): (8 * _MOST_BYTES, "a signal from bit"),
    ("|", "@"): (_MOST_SIGNAL_BITS, "a signal of bits"),
}
"""The most that a number between two signs may be, and what it is; None stands for no sign."""


def _require_bounded_sizes(text: str, source: str) -> None:
    """Refuse DBC text with messages or signals that no bus carries."""
    sign: str | None = None
    number: re.Match[str] | None = None
    for token in _TOKEN.finditer(text):
        if token["comment"]:
            continue
        if number is not None and (sign, token["sign"]) in _LIMITS:
            most, what = _LIMITS[sign or "", token["sign"]]
            if len(number[0]) > 9 or int(number[0]) > most:
                line = text.count("\n", 0, number.start()) + 1
                raise ChannelMapError(
                    f"{source}: line {line}: {what} {number[0][:20]}; it must be at most {most}"
                )
        if token["number"] and number is None:
            number = token
        else:
            sign, number = token["sign"], None


def _message_of(database: Database, name: str, where: str) -> Message:
    names = [message.name for message in database.messages]
    if name not in names:
        raise ChannelMapError(f"{where}: no message {name}; there are {some_of(names)}")
    found = database.messages[names.index(name)]
    number = (found.frame_id, found.is_extended_frame)
    same = [
        other.name
        for other in database.messages
        if other is not found
        and (other.name == name or (other.frame_id, other.is_extended_frame) == number)
    ]
    if same:
        raise ChannelMapError(
            f"{where}: {name} and {same[0]} have the same name or the same id; a frame is of one "
            "message"
        )
    if found.is_multiplexed() or found.is_fd or found.is_container:
        raise ChannelMapError(
            f"{where}: message {name} is multiplexed, a container or of CAN FD; only plain "
            "messages of at most 8 bytes are read"
        )
    return found


def _signal_of(database: Database, message_name: str, name: str, where: str) -> Signal:
    message = _message_of(database, message_name, where)
    signals = {signal.name: signal for signal in message.signals}
    if name not in signals:
        raise ChannelMapError(
            f"{where}: no signal {name} in message {message.name}; there are "
            f"{some_of(list(signals)) or 'none'}"
        )
    signal = signals[name]
    if not all(abs(number) <= _LARGEST_FACTOR for number in (signal.scale, signal.offset)):
        raise ChannelMapError(
            f"{where}: factor or offset of {signal.name} is no number that a sensor has; "
            f"both must be finite, at most {_LARGEST_FACTOR:g}"
        )
    return signal
