"""Tensions to frames, by the channel map and its DBC file: the inverse of the decoder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite

import can
from cantools.database.can import Database, Signal

from cablesense_ros.can.channel_map import ChannelMap, ChannelMapError


class FrameEncoder:
    """Encodes one cycle of frames: the counter's first, then the others by ascending id.

    A tension beyond what a signal's bits can carry is sent as the last value that they can, as
    real converters do.
    """

    def __init__(self, channel_map: ChannelMap, database: Database) -> None:
        """`channel_map` must fit `database` (`signal_database.check_fit`)."""
        self._map = channel_map
        self._counter = channel_map.counter
        names = {channel.message for channel in channel_map.channels.values()}
        if self._counter:
            names.discard(self._counter.message)
        self._messages = sorted(
            (database.get_message_by_name(name) for name in names), key=lambda m: m.frame_id
        )
        if self._counter:
            self._messages.insert(0, database.get_message_by_name(self._counter.message))
        self._signals = {
            message.name: {signal.name: signal for signal in message.signals}
            for message in self._messages
        }

    def cycle(
        self,
        tensions_n: Sequence[float],
        counter: int,
        statuses: Mapping[str, int] | None = None,
    ) -> list[can.Message]:
        """The frames of one cycle.

        Args:
            tensions_n: (M,) in the order of the map.
            counter: number of the cycle; it wraps as its signal does.
            statuses: of cables whose status is not 0.

        Raises:
            ChannelMapError: a tension is not finite and its signal is no floating one.
        """
        raw = {name: dict.fromkeys(signals, 0.0) for name, signals in self._signals.items()}
        for (cable, channel), tension_n in zip(
            self._map.channels.items(), tensions_n, strict=True
        ):
            signal = self._signals[channel.message][channel.signal]
            raw[channel.message][channel.signal] = _raw(signal, channel.value(tension_n))
            if channel.status is not None and statuses is not None:
                raw[channel.message][channel.status] = statuses.get(cable, 0)
        if self._counter is not None:
            bits = self._signals[self._counter.message][self._counter.signal].length
            raw[self._counter.message][self._counter.signal] = counter % (1 << bits)
        return [
            can.Message(
                arbitration_id=message.frame_id,
                is_extended_id=message.is_extended_frame,
                data=message.encode(raw[message.name], scaling=False, strict=False),
            )
            for message in self._messages
        ]

    def frame_id(self, cable: str) -> int:
        """The id of the frame that carries a cable's reading."""
        name = self._map.channels[cable].message
        return next(message.frame_id for message in self._messages if message.name == name)

    def is_float(self, cable: str) -> bool:
        """Whether a cable's signal is a floating one, which alone can carry NaN."""
        channel = self._map.channels[cable]
        return bool(self._signals[channel.message][channel.signal].is_float)


def _raw(signal: Signal, value: float) -> float:
    scaled = (value - signal.offset) / signal.scale
    if signal.is_float:
        return float(scaled)
    if not isfinite(scaled):
        raise ChannelMapError(
            f"signal {signal.name} is a whole number and cannot carry {value}; only a floating "
            "signal can"
        )
    lowest = -(1 << (signal.length - 1)) if signal.is_signed else 0
    highest = (1 << (signal.length - signal.is_signed)) - 1
    return max(lowest, min(highest, round(scaled)))
