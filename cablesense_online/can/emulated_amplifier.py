"""An emulated amplifier: tensions to frames by the channel map, with a fault on request.

`FrameEncoder` is the inverse of the decoder. `EmulatedAmplifier` gives the frames of each cycle;
a fault is requested as text: its kind, and a cable where it concerns one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import NamedTuple

import can
from cantools.database.can import Database, Signal

from cablesense_base import CableSenseError
from cablesense_online.can.bus import (
    BUS_ERROR_CLASS,
    BUS_OFF_CLASS,
    HEARTBEAT_ID,
    NMT_ID,
    RESTARTED_CLASS,
    START_REMOTE_NODE,
    FaultKind,
)
from cablesense_online.can.channel_map import ChannelMap, ChannelMapError

_GAP_CYCLES = 3
_CYCLES_PER_GAP = 50
_LATE_FACTOR = 1.5
_FLOOD_FACTOR = 2.0
_BEYOND_N = 1.0
_NODE_BITS = 0x7F


class FaultRequestError(CableSenseError):
    """A fault that cannot be shown: lists those that can."""


class FaultRequest(NamedTuple):
    """One fault; `cable` is empty for a fault of the whole bus."""

    kind: FaultKind
    cable: str = ""


class PlannedFrame(NamedTuple):
    """A frame and how long after the one before it is sent."""

    frame: can.Message
    wait_s: float = 0.0


class EmulatedAmplifier:
    """Gives the frames of each cycle.

    Amplifiers of a map with `nmt_start_nodes` are silent until each node was started, as CANopen
    wants (CiA 301).

    Attributes:
        fault: what goes wrong at present; None for nothing.
    """

    def __init__(self, channel_map: ChannelMap, database: Database) -> None:
        self._map = channel_map
        self._encoder = FrameEncoder(channel_map, database)
        described = {message.frame_id for message in database.messages}
        lowest_priority = next((n for n in range(0x7FF, 0, -1) if n not in described), 0x7FF)
        self._undescribed = can.Message(
            arbitration_id=lowest_priority, is_extended_id=False, data=bytes(8)
        )
        self._cycle = 0
        self._frozen_n: float | None = None
        self._was_off = False
        self._started: set[int] = set()
        self.fault: FaultRequest | None = None

    def requested(self, text: str) -> FaultRequest | None:
        """The fault that a text requests (`missing_channel cable_5`); empty text requests none.

        Raises:
            FaultRequestError: an unknown fault or cable, or one that these amplifiers cannot show.
        """
        name, *cables = text.split() or [""]
        if not name:
            return None
        kinds = {kind.name.lower(): kind for kind in FaultKind}
        if name not in kinds:
            raise FaultRequestError(f"unknown fault {name[:40]!r}; there are {', '.join(kinds)}")
        kind, channels = kinds[name], self._map.channels
        if not kind.of_cable:
            if cables:
                raise FaultRequestError(f"{name} concerns the whole bus; leave the cable out")
            if kind is FaultKind.COUNTER_GAP and self._map.counter is None:
                raise FaultRequestError(
                    f"map {self._map.name} has no cycle counter to leave a gap"
                )
            return FaultRequest(kind)
        if len(cables) != 1 or cables[0] not in channels:
            names = self._map.cable_names
            raise FaultRequestError(
                f"{name} needs one cable of {names[0]} … {names[-1]}, as in '{name} {names[0]}'"
            )
        (cable,) = cables
        if kind is FaultKind.INVALID_STATUS and channels[cable].status is None:
            raise FaultRequestError(f"{cable} has no status in map {self._map.name}")
        if kind is FaultKind.NOT_FINITE and not self._encoder.is_float(cable):
            raise FaultRequestError(
                f"{cable} is sent as a whole number, which cannot be NaN; request over_range"
            )
        return FaultRequest(kind, cable)

    def request(self, text: str) -> None:
        """Show a fault from the next cycle on; empty text ends it.

        Raises:
            FaultRequestError: as `requested`.
        """
        self.fault = self.requested(text)
        self._frozen_n = None

    def power_up(self) -> list[can.Message]:
        """The frames of nodes that get power: the boot-up messages of CANopen ones."""
        self._started.clear()
        return [
            can.Message(arbitration_id=HEARTBEAT_ID + node, is_extended_id=False, data=[0])
            for node in self._map.nmt_start_nodes
        ]

    def take(self, frame: can.Message) -> None:
        """Take a frame that someone else sent: an NMT start, or nothing of interest."""
        if frame.arbitration_id != NMT_ID or len(frame.data) != 2 or frame.is_error_frame:
            return
        command, node = frame.data
        if command == START_REMOTE_NODE:
            nodes = set(self._map.nmt_start_nodes)
            self._started |= nodes if node == 0 else nodes & {node}

    def cycle(self, tensions_n: Sequence[float]) -> list[PlannedFrame]:
        """The frames of one cycle, in their order; (M,) tensions in the order of the map."""
        kind = self.fault.kind if self.fault else None
        self._cycle += 1
        if kind is FaultKind.COUNTER_GAP and self._cycle % _CYCLES_PER_GAP == 0:
            self._cycle += _GAP_CYCLES
        if kind is FaultKind.BUS_OFF:
            first, self._was_off = not self._was_off, True
            return [_error_frame(BUS_OFF_CLASS)] if first else []
        planned = [_error_frame(RESTARTED_CLASS)] if self._was_off else []
        self._was_off = False
        if kind in (FaultKind.SILENT_BUS, FaultKind.INTERFACE_LOST):
            return planned
        values, statuses = self._faulty_readings(tensions_n)
        frames = self._encoder.cycle(values, self._cycle, statuses)
        if self._map.nmt_start_nodes:
            frames = [f for f in frames if f.arbitration_id & _NODE_BITS in self._started]
        return planned + self._faulty_frames(frames)

    def _faulty_readings(self, tensions_n: Sequence[float]) -> tuple[list[float], dict[str, int]]:
        values, status = [float(tension_n) for tension_n in tensions_n], 0
        if self.fault is None or not self.fault.cable:
            return values, {}
        at, masks = self._map.cable_names.index(self.fault.cable), self._map.status_masks
        low, high = self._map.range_n
        match self.fault.kind:
            case FaultKind.OVER_RANGE:
                values[at], status = high + _BEYOND_N, masks.over_range
            case FaultKind.UNDER_RANGE:
                values[at], status = low - _BEYOND_N, masks.under_range
            case FaultKind.STUCK_VALUE:
                self._frozen_n = values[at] if self._frozen_n is None else self._frozen_n
                values[at] = self._frozen_n
            case FaultKind.NOT_FINITE:
                values[at] = float("nan")
            case FaultKind.INVALID_STATUS:
                status = masks.invalid
        return values, {self.fault.cable: status}

    def _faulty_frames(self, frames: list[can.Message]) -> list[PlannedFrame]:
        planned = [PlannedFrame(frame) for frame in frames]
        if self.fault is None:
            return planned
        number = self._encoder.frame_id(self.fault.cable) if self.fault.cable else -1
        others = [one for one in planned if one.frame.arbitration_id != number]
        ours = [one.frame for one in planned if one.frame.arbitration_id == number]
        match self.fault.kind:
            case FaultKind.UNKNOWN_ID:
                return [*planned, PlannedFrame(self._undescribed)]
            case FaultKind.ERROR_FRAME:
                return [*planned, _error_frame(BUS_ERROR_CLASS)]
            case FaultKind.FLOODED:
                count = int(_FLOOD_FACTOR * self._map.flood_frames_s * self._map.cycle_time_s)
                return planned + [PlannedFrame(self._undescribed)] * max(1, count)
            case FaultKind.MISSING_CHANNEL:
                return others
            case FaultKind.LATE_CHANNEL:
                late_s = _LATE_FACTOR * self._map.skew_limit_s
                return others + [PlannedFrame(frame, late_s) for frame in ours]
            case FaultKind.WRONG_LENGTH:
                for frame in ours:
                    frame.data, frame.dlc = frame.data[:-1], frame.dlc - 1
                return others + [PlannedFrame(frame) for frame in ours]
            case FaultKind.UNREADABLE:
                remote = can.Message(
                    arbitration_id=number, is_extended_id=False, is_remote_frame=True, dlc=8
                )
                return [*others, PlannedFrame(remote)]
        return planned


class FrameEncoder:
    """Encodes one cycle of frames: the counter's first, then the others by ascending id.

    A tension beyond what a signal's bits can carry is sent as the last value that they can, as
    real converters do.
    """

    def __init__(self, channel_map: ChannelMap, database: Database) -> None:
        """`channel_map` must fit `database` (`channel_map.check_fit`)."""
        self._map = channel_map
        self._counter = channel_map.counter
        opens = self._counter.message if self._counter else None
        self._messages = sorted(
            map(database.get_message_by_name, channel_map.message_names),
            key=lambda message: (message.name != opens, message.frame_id),
        )
        self._signals = {
            message.name: {signal.name: signal for signal in message.signals}
            for message in self._messages
        }

    def cycle(
        self, tensions_n: Sequence[float], counter: int, statuses: Mapping[str, int] | None = None
    ) -> list[can.Message]:
        """The frames of one cycle: (M,) tensions in the order of the map.

        The counter wraps as its signal does; `statuses` are those that are not 0.

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


def _error_frame(number: int) -> PlannedFrame:
    frame = can.Message(
        arbitration_id=number, is_extended_id=False, is_error_frame=True, data=bytes(8)
    )
    return PlannedFrame(frame)
