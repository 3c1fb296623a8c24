"""Frames to readings in N, by the channel map and its DBC file (cantools decodes)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import can
from cantools.database.can import Database, Message

from cablesense_ros.can.channel_map import ChannelMap, StatusMasks
from cablesense_ros.can.fault import FaultKind
from cablesense_ros.can.fault_ledger import FaultLedger
from cablesense_ros.can.reading_check import reading_fault


@dataclass(frozen=True, slots=True)
class Decoded:
    """What one frame tells.

    Attributes:
        readings: (channel, N) pairs; the channel is its position in the map.
        spoilt: whether one of them cannot be believed.
        counter: of the cycle that the frame opens, if it does.
    """

    readings: Sequence[tuple[int, float]] = ()
    spoilt: bool = False
    counter: int | None = None


@dataclass(frozen=True, slots=True)
class _Place:
    channel: int
    cable: str
    signal: str
    status: str | None
    scale_n_per_unit: float
    zero: float


@dataclass(frozen=True, slots=True)
class _Plan:
    message: Message
    places: tuple[_Place, ...]
    counter: str | None


class FrameDecoder:
    """Decodes the frames of the map; notes what cannot be one of them.

    Attributes:
        counter_modulo: the counter starts again at 0 when it would reach this; 0 without one.
        frames_per_cycle: messages that make one sample, the counter's included.
    """

    def __init__(self, channel_map: ChannelMap, database: Database, ledger: FaultLedger) -> None:
        """`channel_map` must fit `database` (`signal_database.check_fit`)."""
        self._ledger = ledger
        self._range_n = channel_map.range_n
        self._masks = channel_map.status_masks
        self._plans: dict[tuple[int, bool], _Plan] = {}
        self.counter_modulo = 0
        self._described = {(m.frame_id, m.is_extended_frame) for m in database.messages}
        counter = channel_map.counter
        names = {channel.message for channel in channel_map.channels.values()}
        names |= {counter.message} if counter else set()
        self.frames_per_cycle = len(names)
        for name in sorted(names):
            message = database.get_message_by_name(name)
            counts = counter.signal if counter and counter.message == name else None
            if counts:
                self.counter_modulo = 1 << message.get_signal_by_name(counts).length
            key = (message.frame_id, message.is_extended_frame)
            self._plans[key] = _Plan(message, _places(channel_map, name), counts)

    def knows(self, frame: can.Message) -> bool:
        """Whether the frame's id is one that carries readings or the counter."""
        return (frame.arbitration_id, frame.is_extended_id) in self._plans

    def decode(self, frame: can.Message) -> Decoded | None:
        """What a frame tells; None for one that tells nothing, which is noted unless described.

        A frame of the right id whose length is wrong tells nothing: what its bytes mean is open.
        """
        key = (frame.arbitration_id, frame.is_extended_id)
        plan = self._plans.get(key)
        if plan is None:
            if key not in self._described:
                self._ledger.note(FaultKind.UNKNOWN_ID, f"0x{frame.arbitration_id:X}")
            return None
        if frame.is_remote_frame or frame.is_fd:
            self._ledger.note(
                FaultKind.UNREADABLE,
                plan.message.name,
                f"{plan.message.name} came as a remote or CAN FD frame, not as a data frame",
            )
            return None
        if len(frame.data) != plan.message.length:
            self._ledger.note(
                FaultKind.WRONG_LENGTH,
                plan.message.name,
                f"{plan.message.name} came with {len(frame.data)} bytes; the DBC file says "
                f"{plan.message.length}",
            )
            return None
        values = plan.message.decode(bytes(frame.data), decode_choices=False)
        return self._readings(plan, values)  # type: ignore[arg-type]  # no container, no choices

    def _readings(self, plan: _Plan, values: dict[str, float]) -> Decoded:
        low, high = self._range_n
        readings, spoilt = [], False
        for place in plan.places:
            tension_n = place.scale_n_per_unit * (values[place.signal] - place.zero)
            status = int(values[place.status]) if place.status is not None else 0
            if status or not low < tension_n < high:
                fault = _fault(tension_n, status, self._range_n, self._masks)
                if fault is not None:
                    spoilt = True
                    self._ledger.note(fault, place.cable, _sentence(place, tension_n, status))
            readings.append((place.channel, tension_n))
        counter = int(values[plan.counter]) if plan.counter is not None else None
        return Decoded(readings, spoilt, counter)


def _fault(
    tension_n: float, status: int, range_n: tuple[float, float], masks: StatusMasks
) -> FaultKind | None:
    if status & masks.over_range:
        return FaultKind.OVER_RANGE
    if status & masks.under_range:
        return FaultKind.UNDER_RANGE
    if status & masks.invalid:
        return FaultKind.INVALID_STATUS
    return reading_fault(tension_n, range_n)


def _sentence(place: _Place, tension_n: float, status: int) -> str:
    said = f", status 0x{status:02X}" if status else ""
    return f"{place.cable} reads {tension_n:g} N{said}"


def _places(channel_map: ChannelMap, message: str) -> tuple[_Place, ...]:
    return tuple(
        _Place(
            position, cable, channel.signal, channel.status, channel.scale_n_per_unit, channel.zero
        )
        for position, (cable, channel) in enumerate(channel_map.channels.items())
        if channel.message == message
    )
