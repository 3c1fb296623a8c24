"""What error frames say of the bus: their classes, and whether the controller is off the bus.

Classes and bits are those of SocketCAN (`linux/can/error.h`), which python-can passes on in the
id and data of a frame with `is_error_frame`. Other interfaces send error frames with codes of
their own, or none: slcan has no such frames, `virtual` and `udp_multicast` no bus that could fail.

Keeps a flood of frames from becoming a flood of work or of samples.

Finding a channel that stands still while the others move.

Bus timestamps to this machine's clock.
"""

from __future__ import annotations

from enum import Enum
from math import isfinite

import numpy as np

from cablesense_base.arrays import Array
from cablesense_online.can.channel_map import StuckLimits
from cablesense_online.can.faults import FaultKind, FaultLedger

BUS_OFF_CLASS = 0x40
RESTARTED_CLASS = 0x100
CONTROLLER_CLASS = 0x04
_CLASSES = {
    0x01: "transmit timeout",
    0x02: "lost arbitration",
    CONTROLLER_CLASS: "controller",
    0x08: "protocol violation",
    0x10: "transceiver",
    0x20: "no acknowledge",
    BUS_OFF_CLASS: "bus off",
    0x80: "bus error",
    RESTARTED_CLASS: "controller restarted",
}
_CONTROLLER_BITS = {
    0x01: "receive buffer overflow",
    0x02: "transmit buffer overflow",
    0x04: "receive warning",
    0x08: "transmit warning",
    0x10: "receive passive",
    0x20: "transmit passive",
    0x40: "active again",
}
_WARNING_BITS, _PASSIVE_BITS, _ACTIVE_BIT = 0x0C, 0x30, 0x40


class BusCondition(Enum):
    """The controller's error state (ISO 11898-1); the value is what diagnostics call it."""

    ACTIVE = "error active"
    WARNING = "error warning"
    PASSIVE = "error passive"
    OFF = "bus off"


class BusWatch:
    """Follows the condition of the bus.

    Attributes:
        condition: the present one.
        recoveries: how often the controller came back from bus off.
    """

    def __init__(self, place: str, classes: bool, ledger: FaultLedger) -> None:
        """`place` names the interface; `classes` says if error frames bear SocketCAN's classes.

        Without them error frames are counted, and the condition stays unknown, that is active.
        """
        self._place = place
        self._classes = classes
        self._ledger = ledger
        self.condition = BusCondition.ACTIVE
        self.recoveries = 0

    def error_frame(self, arbitration_id: int, data: bytes) -> None:
        """Take an error frame in.

        A controller that is off the bus neither sends nor receives until it is restarted: by the
        kernel after `restart-ms`, by an adapter's own rule, or by reopening it.
        """
        if not self._classes:
            self._ledger.note(FaultKind.ERROR_FRAME, self._place, "an error frame without class")
            return
        if arbitration_id & BUS_OFF_CLASS:
            if self.condition is not BusCondition.OFF:
                self._ledger.note(
                    FaultKind.BUS_OFF, self._place, error_words(arbitration_id, data)
                )
            self.condition = BusCondition.OFF
            return
        self._ledger.note(FaultKind.ERROR_FRAME, self._place, error_words(arbitration_id, data))
        if arbitration_id & RESTARTED_CLASS:
            self._recover()
        if arbitration_id & CONTROLLER_CLASS and len(data) > 1:
            self._controller(data[1])

    def data_frame(self) -> None:
        """A data frame came, so the controller is on the bus."""
        if self.condition is BusCondition.OFF:
            self._recover()

    def reopened(self) -> None:
        """The interface was opened anew."""
        self.condition = BusCondition.ACTIVE

    def _recover(self) -> None:
        if self.condition is BusCondition.OFF:
            self.recoveries += 1
        self.condition = BusCondition.ACTIVE

    def _controller(self, bits: int) -> None:
        if self.condition is BusCondition.OFF:
            return
        if bits & _PASSIVE_BITS:
            self.condition = BusCondition.PASSIVE
        elif bits & _WARNING_BITS:
            self.condition = BusCondition.WARNING
        elif bits & _ACTIVE_BIT:
            self.condition = BusCondition.ACTIVE


def error_words(arbitration_id: int, data: bytes) -> str:
    """What an error frame says, in words."""
    words = [word for bit, word in _CLASSES.items() if arbitration_id & bit]
    if arbitration_id & CONTROLLER_CLASS and len(data) > 1:
        words += [word for bit, word in _CONTROLLER_BITS.items() if data[1] & bit]
    return ", ".join(words) or f"error frame of class 0x{arbitration_id:X}"


KNOWN_EXCESS = 2.0
"""Frames of the map may come at this many times their rate; what exceeds it is dropped."""

ALLOWANCE_S = 0.5
"""So long a burst may last before it counts: a process that was held up reads its backlog in one
go, and loses none of it."""


class FloodWatch:
    """Admits frames by rate, with two buckets: one for all frames, one for those of the map.

    Unknown frames are cheap and are let by at any rate; once all frames together exceed the limit
    this is noted. Frames of the map beyond twice their rate come from a babbling node; they are
    dropped, so that samples are never given at more than that rate.
    """

    def __init__(self, limit_frames_s: float, known_frames_s: float, ledger: FaultLedger) -> None:
        self._ledger = ledger
        self._all = _Bucket(limit_frames_s)
        self._known = _Bucket(KNOWN_EXCESS * known_frames_s)

    def admit(self, known: bool, now_s: float) -> bool:
        """Whether a frame may be worked on.

        Args:
            known: its id is one of the map.
            now_s: monotonic time of its arrival.
        """
        if not self._all.take(now_s):
            self._ledger.note(
                FaultKind.FLOODED,
                "bus",
                f"more than {self._all.rate:g} frames a second for {ALLOWANCE_S:g} s",
            )
        if not known or self._known.take(now_s):
            return True
        self._ledger.note(
            FaultKind.FLOODED,
            "amplifier",
            f"more than {self._known.rate:g} frames of the map a second for {ALLOWANCE_S:g} s; "
            "the excess is dropped",
        )
        return False


class _Bucket:
    """A token bucket: `rate` tokens a second, at most `ALLOWANCE_S` of them in store."""

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self._most = max(1.0, rate * ALLOWANCE_S)
        self._tokens = self._most
        self._last_s: float | None = None

    def take(self, now_s: float) -> bool:
        if self._last_s is not None:
            self._tokens = min(self._most, self._tokens + (now_s - self._last_s) * self.rate)
        self._last_s = now_s
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class StuckWatch:
    """Tells which readings are stuck.

    A resting arm's readings may well stay the same to the last bit, as noise can be smaller than
    the converter's step: standing still alone is no fault. Standing still for `after_s` while half
    of the other channels have moved by more than `others_moved_n` is. A channel once found stuck
    stays so until its reading changes.
    """

    def __init__(self, channel_count: int, limits: StuckLimits) -> None:
        self._limits = limits
        self._last_n: Array = np.full(channel_count, np.nan)
        self._since_s = np.zeros(channel_count)
        self._then_n = np.zeros((channel_count, channel_count))
        self._stuck = np.zeros(channel_count, dtype=bool)
        self._needed = max(1, -(-(channel_count - 1) // 2))

    def stuck(self, tensions_n: Array, time_s: float) -> tuple[int, ...]:
        """Positions of the channels that are stuck in this sample.

        Args:
            tensions_n: (M,) readings of a whole sample.
            time_s: its time, ascending.
        """
        changed = tensions_n != self._last_n
        self._last_n = tensions_n.copy()
        self._since_s[changed] = time_s
        self._then_n[changed] = tensions_n
        self._stuck[changed] = False
        still = time_s - self._since_s >= self._limits.after_s
        if still.any():
            moved = np.abs(tensions_n - self._then_n[still]) > self._limits.others_moved_n
            self._stuck[still] |= moved.sum(axis=1) >= self._needed
        if not self._stuck.any():
            return ()
        return tuple(np.flatnonzero(self._stuck).tolist())

    def restart(self) -> None:
        """Forget what was, after a time without samples."""
        self._last_n = np.full_like(self._last_n, np.nan)
        self._stuck[:] = False


SAME_CLOCK_S = 0.05
"""Timestamps that lag this machine's clock by no more are of that clock, as SocketCAN's are."""

DRIFT = 200e-6
"""The most by which two quartz clocks drift apart, with a margin."""

JUMP_S = 2.0
"""A lag that changes by more than this at once is a clock that was set, not a busy machine."""


class BusClock:
    """Gives every frame's time by this machine's clock.

    Adapters stamp by this machine's clock, or by their own, which starts when they do. From the
    latter the smallest lag of arrival behind stamp is taken off: it is the clocks' distance plus
    the shortest way, and follows their drift. Frames without a usable stamp count from arrival.
    """

    def __init__(self) -> None:
        self._lag_s: float | None = None
        self._last_now_s = 0.0

    def time_s(self, stamp_s: float, now_s: float) -> float:
        """The frame's time, s since the epoch.

        Args:
            stamp_s: as the bus interface gives it.
            now_s: of its arrival, by this machine's clock, s since the epoch.
        """
        if not isfinite(stamp_s) or stamp_s <= 0.0:
            return now_s
        lag_s = now_s - stamp_s
        known_s = self._lag_s
        if known_s is None or lag_s - known_s > JUMP_S:
            self._lag_s = lag_s
        else:
            self._lag_s = min(lag_s, known_s + DRIFT * max(0.0, now_s - self._last_now_s))
        self._last_now_s = now_s
        same_clock = 0.0 <= self._lag_s <= SAME_CLOCK_S
        return stamp_s if same_clock else stamp_s + self._lag_s

    def restart(self) -> None:
        """The interface was opened again, and its clock may have started anew."""
        self._lag_s = None
