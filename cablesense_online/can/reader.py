"""Samples of tensions from received frames: decoded, stamped, assembled, and withheld if in doubt.

`TensionReader` passes each frame to the decoder (cantools), the bus clock and the assembler, and
each whole sample to the search for stuck channels. A sample that is not whole, late or invalid is
dropped, never filled up.
"""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

import can
import numpy as np
from cantools.database.can import Database, Message

from cablesense_base import Array
from cablesense_online.can.assembler import AssembledSample, Decoded, SampleAssembler
from cablesense_online.can.bus import ERROR_ACTIVE, BusState, CanInterface, FaultKind, FaultLedger
from cablesense_online.can.channel_map import Channel, ChannelMap, StuckLimits

SCATTER_OF_READING_S = 0.1
"""Skew limit for frames that have the time of reading: any pause of the process would look late.
No channel comes twice in a sample, so the order of frames limits the skew to one cycle."""
SAME_CLOCK_LAG_S = 0.05
"""Largest lag of arrival behind a time stamp of this machine's own clock, as SocketCAN's are."""
HOLD_CYCLES = 2.0
"""A silence of this many cycles gives the held sample, as a next cycle would."""
DRIFT = 200e-6
"""Upper limit of the relative drift of two quartz clocks."""
JUMP_S = 2.0
"""A larger sudden increase of the lag is a clock that was set, not a busy machine."""


class _Plan(NamedTuple):
    """A message of the map, its channels with position and cable, and its counter's signal."""

    message: Message
    label: str
    channels: tuple[tuple[int, str, Channel], ...]
    counter: str | None


class FrameDecoder:
    """Decodes the frames of the map and notes faulty ones.

    The counter restarts at 0 when it would reach `counter_modulo`, which is 0 without a counter.
    """

    def __init__(self, channel_map: ChannelMap, database: Database, ledger: FaultLedger) -> None:
        """`channel_map` must fit `database` (`channel_map.check_fit`)."""
        self._map = channel_map
        self._ledger = ledger
        self._described = {(m.frame_id, m.is_extended_frame) for m in database.messages}
        self._plans: dict[tuple[int, bool], _Plan] = {}
        self.counter_modulo = 0
        numbered = [(n, *item) for n, item in enumerate(channel_map.channels.items())]
        for name in channel_map.message_names:
            message = database.get_message_by_name(name)
            counter = None
            if channel_map.counter and channel_map.counter.message == name:
                counter = channel_map.counter.signal
                self.counter_modulo = 1 << message.get_signal_by_name(counter).length
            channels = tuple(entry for entry in numbered if entry[2].message == name)
            key = (message.frame_id, message.is_extended_frame)
            label = f"{name} (0x{message.frame_id:X})"
            self._plans[key] = _Plan(message, label, channels, counter)

    def decode(self, frame: can.Message) -> Decoded | None:
        """A frame's content; none, with a noted fault, if the frame has another form or id.

        Other ids that the DBC file describes have no content and are no fault.
        """
        key = (frame.arbitration_id, frame.is_extended_id)
        plan = self._plans.get(key)
        if plan is None:
            if key not in self._described:
                self._ledger.note(FaultKind.UNKNOWN_ID, f"0x{frame.arbitration_id:X}")
            return None
        name = plan.message.name
        length = plan.message.length
        if frame.is_remote_frame or frame.is_fd or len(frame.data) != length:
            kind = "remote" if frame.is_remote_frame else "CAN FD" if frame.is_fd else "data"
            detail = f"{name} came as a {kind} frame with {len(frame.data)} bytes"
            detail += f"; the DBC file describes a data frame with {length}"
            self._ledger.note(FaultKind.WRONG_LENGTH, name, detail)
            return None
        values = plan.message.decode(bytes(frame.data), decode_choices=False)
        return self._readings(plan, values)  # type: ignore[arg-type]  # no container, no choices

    def _readings(self, plan: _Plan, values: dict[str, float]) -> Decoded:
        low, high = self._map.range_n
        readings = []
        valid = True
        for number, cable, channel in plan.channels:
            tension_n = channel.tension_n(values[channel.signal])
            status = int(values[channel.status]) if channel.status is not None else 0
            fault = (
                self._fault(tension_n, status) if status or not low < tension_n < high else None
            )
            if fault is not None:
                valid = False
                suffix = f", status 0x{status:02X}" if status else ""
                self._ledger.note(fault, cable, f"{cable} reads {tension_n:g} N{suffix}")
            readings.append((number, tension_n))
        counter = int(values[plan.counter]) if plan.counter is not None else None
        return Decoded(readings, valid, counter, plan.label)

    def _fault(self, tension_n: float, status: int) -> FaultKind | None:
        (low, high) = self._map.range_n
        masks = self._map.status_masks
        if status & masks.over_range or (tension_n >= high and isfinite(tension_n)):
            return FaultKind.OVER_RANGE
        if status & masks.under_range or (tension_n <= low and isfinite(tension_n)):
            return FaultKind.UNDER_RANGE
        if status & masks.invalid:
            return FaultKind.INVALID_STATUS
        return None if isfinite(tension_n) else FaultKind.NOT_FINITE


class StuckDetector:
    """Finds channels that stand still while the others move.

    Noise can be smaller than the converter's step, so readings of an arm in static equilibrium
    may stay the same to the last bit. A channel is stuck if it stands still for `after_s` while
    half of the others move by more than `others_moved_n`. It stays so until its reading changes.
    """

    def __init__(self, channel_count: int, limits: StuckLimits) -> None:
        self._limits = limits
        self._last_n: Array = np.full(channel_count, np.nan)
        self._since_s = np.zeros(channel_count)
        self._then_n = np.zeros((channel_count, channel_count))
        self._stuck = np.zeros(channel_count, dtype=bool)
        self._needed = max(1, channel_count // 2)

    def stuck(self, tensions_n: Array, time_s: float) -> list[int]:
        """Positions of the channels that are stuck in a sample (M,); times ascend."""
        changed = tensions_n != self._last_n
        self._last_n = tensions_n.copy()
        self._since_s[changed] = time_s
        self._then_n[changed] = tensions_n
        self._stuck[changed] = False
        still = time_s - self._since_s >= self._limits.after_s
        if still.any():
            moved = np.abs(tensions_n - self._then_n[still]) > self._limits.others_moved_n
            self._stuck[still] |= moved.sum(axis=1) >= self._needed
        return np.flatnonzero(self._stuck).tolist() if self._stuck.any() else []


class BusClock:
    """Converts bus time stamps to this machine's clock.

    Some adapters have their own clock, which starts when they do. The smallest lag of arrival
    behind the stamp is the distance of the clocks plus the shortest delay; it follows their
    drift. Frames without a usable stamp count from their arrival.
    """

    def __init__(self) -> None:
        self._lag_s: float | None = None
        self._last_now_s = 0.0

    def time_s(self, stamp_s: float, now_s: float) -> float:
        """Time of a frame from its stamp and its arrival `now_s`, s since the epoch."""
        if not isfinite(stamp_s) or stamp_s <= 0.0:
            return now_s
        lag_s = now_s - stamp_s
        known_s = self._lag_s
        if known_s is not None and lag_s - known_s <= JUMP_S:
            lag_s = min(lag_s, known_s + DRIFT * max(0.0, now_s - self._last_now_s))
        self._lag_s = lag_s
        self._last_now_s = now_s
        return stamp_s if 0.0 <= lag_s <= SAME_CLOCK_LAG_S else stamp_s + lag_s


class TensionReader:
    """Takes frames as they arrive, and gives a sample only if all of it is valid.

    Attributes:
        hold_s: silence after which a held sample may be given.
        bus: the error state of the bus.
        frames, samples: number of frames taken, of any kind, and of samples given.
        largest_skew_s: of the samples given since the caller last set it to zero.
    """

    def __init__(
        self,
        channel_map: ChannelMap,
        database: Database,
        interface: CanInterface,
        ledger: FaultLedger,
    ) -> None:
        """`interface` is the source of the frames; it is not opened here."""
        self._map = channel_map
        self._ledger = ledger
        self._decoder = FrameDecoder(channel_map, database, ledger)
        self._skew_limit_s = channel_map.skew_limit_s
        self._stamped = interface.stamps_frames
        if not self._stamped:
            self._skew_limit_s = max(self._skew_limit_s, SCATTER_OF_READING_S)
        self.hold_s = HOLD_CYCLES * channel_map.cycle_time_s
        self.bus = BusState(interface, ledger)
        self.frames = 0
        self.samples = 0
        self._withheld = 0
        self.largest_skew_s = 0.0
        self._restart()

    @property
    def withheld(self) -> int:
        """Number of samples not given because they were not whole, late or invalid."""
        return self._withheld + self._assembler.dropped

    def take(self, frame: can.Message, now_s: float) -> AssembledSample | None:
        """The sample that may be given now, if any; `now_s` is the arrival, s since the epoch."""
        self.frames += 1
        if frame.is_error_frame:
            self.bus.error_frame(frame.arbitration_id, bytes(frame.data))
            return None
        self.bus.data_frame()
        decoded = self._decoder.decode(frame)
        time_s = self._clock.time_s(frame.timestamp, now_s)
        if decoded is not None:
            return self._checked(self._assembler.take(decoded, time_s))
        return self.lapse() if time_s - self._assembler.frame_s >= self.hold_s else None

    def lapse(self) -> AssembledSample | None:
        """The sample that is held, if any, after `hold_s` without a frame."""
        return self._checked(self._assembler.lapse())

    def _checked(self, sample: AssembledSample | None) -> AssembledSample | None:
        if sample is None:
            return None
        stuck = self._stuck.stuck(sample.tensions_n, sample.time_s)
        for channel in stuck:
            name = self._map.cable_names[channel]
            detail = f"{name} stands at {sample.tensions_n[channel]:g} N while the others move"
            self._ledger.note(FaultKind.STUCK_VALUE, name, detail)
        if stuck:
            self._withheld += 1
            return None
        self.samples += 1
        self.largest_skew_s = max(self.largest_skew_s, sample.skew_s)
        return sample

    def reopened(self) -> None:
        """Forget clock, counter, open sample and error state: the interface was opened again."""
        self._withheld += self._assembler.dropped
        self.bus.condition = ERROR_ACTIVE
        self._restart()

    def _restart(self) -> None:
        names = self._map.cable_names
        self._assembler = SampleAssembler(
            names,
            self._map.cycle_time_s,
            self._skew_limit_s,
            self._decoder.counter_modulo,
            self._ledger,
            self._stamped,
        )
        self._stuck = StuckDetector(len(names), self._map.stuck)
        self._clock = BusClock()
