"""The DBC file of a channel map, read by cantools, and whether the map fits it.

The format is Vector's DBC (an open text format in practice, never published as a standard).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cantools
from cantools.database.can import Database, Message, Signal

from cablesense_msgs_py.bounded_file import read_bounded_text
from cablesense_ros.can.channel_map import Channel, ChannelMap, ChannelMapError
from cablesense_ros.can.channel_map_file import MAX_DBC_BYTES, load_channel_map
from cablesense_ros.can.dbc_bounds import require_bounded_sizes

_SHOWN_NAMES = 8
_LARGEST_FACTOR = 1e30


@dataclass(frozen=True)
class ChannelSignal:
    """What the DBC file makes of a channel's bits: `value = factor * bits + offset`, in `unit`."""

    unit: str
    factor: float
    offset: float


def open_channel_map(name_or_path: str | Path) -> tuple[ChannelMap, Database]:
    """Read a map and its DBC file, and check that one fits the other.

    Raises:
        ChannelMapError: either cannot be read, or they do not fit.
    """
    channel_map, path = load_channel_map(name_or_path)
    text = read_bounded_text(path, MAX_DBC_BYTES, "a DBC file", ChannelMapError)
    database = parse_database(text, source=str(path))
    check_fit(channel_map, database, source=str(path))
    return channel_map, database


def parse_database(text: str, source: str = "DBC file") -> Database:
    """Read DBC text; `source` names it in errors.

    Raises:
        ChannelMapError: not DBC, or signals that overlap or leave their message.
    """
    require_bounded_sizes(text, source)
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
        message = message_of(database, channel.message, where)
        _require_credible(_signal_of(message, channel.signal, where), where)
        if channel.status is not None:
            status = _signal_of(message, channel.status, where)
            _require_credible(status, where)
            if status.is_float:
                raise ChannelMapError(
                    f"{where}: status {channel.status} is a floating value; it must be of whole "
                    "bits"
                )
    if channel_map.counter is not None:
        where = f"{source}: counter"
        message = message_of(database, channel_map.counter.message, where)
        counter = _signal_of(message, channel_map.counter.signal, where)
        _require_credible(counter, where)
        if counter.is_float or counter.is_signed or counter.length < 2:
            raise ChannelMapError(
                f"{where}: {counter.name} must be an unsigned whole number of two bits or more, "
                "so that a lost cycle shows"
            )


def channel_signal(database: Database, channel: Channel) -> ChannelSignal:
    """Unit, factor and offset of a channel's value.

    Raises:
        ChannelMapError: the database lacks its message or signal.
    """
    message = message_of(database, channel.message, "DBC file")
    signal = _signal_of(message, channel.signal, "DBC file")
    return ChannelSignal(signal.unit or "", float(signal.scale), float(signal.offset))


def message_of(database: Database, name: str, where: str) -> Message:
    """The message of that name.

    Raises:
        ChannelMapError: there is none, or it is multiplexed or not of classical CAN.
    """
    found = [message for message in database.messages if message.name == name]
    if not found:
        names = [message.name for message in database.messages]
        raise ChannelMapError(f"{where}: no message {name}; there are {_listed(names)}")
    same = [
        message.name
        for message in database.messages
        if message is not found[0]
        and (message.name == name or _id_of(message) == _id_of(found[0]))
    ]
    if same:
        raise ChannelMapError(
            f"{where}: {name} and {same[0]} have the same name or the same id; a frame is of one "
            "message"
        )
    if found[0].is_multiplexed() or found[0].is_fd or found[0].is_container:
        raise ChannelMapError(
            f"{where}: message {name} is multiplexed, a container or of CAN FD; only plain "
            "messages of at most 8 bytes are read"
        )
    return found[0]


def _require_credible(signal: Signal, where: str) -> None:
    if not all(abs(number) <= _LARGEST_FACTOR for number in (signal.scale, signal.offset)):
        raise ChannelMapError(
            f"{where}: factor or offset of {signal.name} is no number that a sensor has; "
            f"both must be finite, at most {_LARGEST_FACTOR:g}"
        )


def _id_of(message: Message) -> tuple[int, bool]:
    return message.frame_id, message.is_extended_frame


def _signal_of(message: Message, name: str, where: str) -> Signal:
    for signal in message.signals:
        if signal.name == name:
            return signal
    names = [signal.name for signal in message.signals]
    raise ChannelMapError(
        f"{where}: no signal {name} in message {message.name}; there are {_listed(names)}"
    )


def _listed(names: list[str]) -> str:
    shown = ", ".join(names[:_SHOWN_NAMES])
    more = len(names) - _SHOWN_NAMES
    return f"{shown} and {more} more" if more > 0 else shown or "none"
