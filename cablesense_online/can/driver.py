"""The CAN driver without ROS: a receiving thread, its samples and its diagnostics.

python-can's Notifier thread ends at the first error, so the receive loop is our own: it opens the
interface again when it is lost.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from time import monotonic

import can
import numpy as np
from cantools.database.can import Database

from cablesense_base import CableSenseError, some_of
from cablesense_msgs_py.messages import Level, Status
from cablesense_online.can.assembler import AssembledSample
from cablesense_online.can.bus import (
    BUS_OFF,
    ERROR_ACTIVE,
    CanInterface,
    FaultKind,
    FaultLedger,
    FaultReport,
    booted_node,
    start_frames,
)
from cablesense_online.can.channel_map import ChannelMap
from cablesense_online.can.reader import TensionReader

FIRST_BACK_OFF_S = 0.05
"""Pause before an interface is opened again; it doubles up to the last one."""
LAST_BACK_OFF_S = 0.5
"""Short enough that samples come again within a second of the interface's return."""
WAKE_S = 0.05
"""How long the driver waits for a frame until it looks whether it is to end."""
REOPEN_AFTER_SILENCE_S = 2.0
"""Some adapters that lost power neither raise nor deliver; reopening sets them up again."""


class CanDriver:
    """Receives samples in a thread between `start` and `stop`; reopens an interface that is lost.

    CANopen nodes of the map's `nmt_start_nodes` are started whenever the interface is opened, and
    each again when its boot-up message shows that it lost power.
    """

    def __init__(
        self,
        channel_map: ChannelMap,
        database: Database,
        interface: CanInterface,
        on_sample: Callable[[AssembledSample], None],
    ) -> None:
        """`on_sample` is called in the receiving thread."""
        self._map = channel_map
        self._interface = interface
        self._on_sample = on_sample
        self.ledger = FaultLedger()
        self._reader = TensionReader(channel_map, database, interface, self.ledger)
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        self._connected = False
        self._openings = 0
        self._last_problem = ""
        self._last_sample_s = monotonic()
        self._report_s = self._last_sample_s
        self._reported = np.zeros(3, dtype=int)

    def start(self) -> None:
        """Begin to receive, as soon as the interface exists."""
        self._last_sample_s = monotonic()
        self._report_s = self._last_sample_s
        self._ended.clear()
        name = f"receive {self._interface.name}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop receiving and close the interface; safe to call twice."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
            self._thread = None

    def report(self, stale_after_s: float) -> tuple[list[Status], FaultReport]:
        """The statuses `interface` and `samples`, and the faults, since the previous report.

        Samples are stale after this time without one. Totals are since the driver was made.
        """
        now_s = monotonic()
        reader = self._reader
        counts = np.array([reader.frames, reader.samples, reader.withheld])
        frames, samples, withheld = (counts - self._reported).tolist()
        period_s = max(now_s - self._report_s, 1e-9)
        self._reported = counts
        self._report_s = now_s
        if frames > self._map.flood_frames_s * max(1.0, period_s):
            detail = f"{frames} frames in {period_s:.1f} s; the map allows "
            detail += f"{self._map.flood_frames_s:g} a second"
            self.ledger.note(FaultKind.FLOODED, "bus", detail)
        faults = self.ledger.report()
        interface = {
            "interface": self._interface.name,
            "frames (1/s)": f"{frames / period_s:.0f}",
            "frames in all": str(reader.frames),
            "bus": reader.bus.condition,
            "recoveries from bus off": str(reader.bus.recoveries),
            "openings": str(self._openings),
            "last problem": self._last_problem or "none",
        }
        values = {
            "rate (Hz)": f"{samples / period_s:.1f}",
            "samples in all": str(reader.samples),
            "withheld": str(withheld),
            "withheld in all": str(reader.withheld),
            "largest skew (s)": f"{reader.largest_skew_s:.6f}",
        }
        reader.largest_skew_s = 0.0
        values |= {f"{kind.value} in all": str(faults.total[kind]) for kind in FaultKind}
        values |= {f"last {kind.value}": detail for kind, detail in faults.last.items()}
        silent_s = now_s - self._last_sample_s
        verdict = _sample_verdict(faults, withheld, silent_s if silent_s > stale_after_s else 0.0)
        return [
            Status("interface", *self._interface_verdict(frames), interface),
            Status("samples", *verdict, values),
        ], faults

    def _interface_verdict(self, frames: int) -> tuple[Level, str]:
        name = self._interface.name
        condition = self._reader.bus.condition
        if not self._connected:
            return Level.ERROR, f"{name} is not open: {self._last_problem}"
        if condition == BUS_OFF:
            return Level.ERROR, "the controller is off the bus and waits to be restarted"
        if condition != ERROR_ACTIVE:
            return Level.WARN, f"the controller is {condition}"
        if not frames:
            return Level.STALE, f"no frame on {name}"
        return Level.OK, f"receiving on {name}"

    def _run(self) -> None:
        back_off_s = FIRST_BACK_OFF_S
        while not self._ended.is_set():
            before = self._reader.frames
            try:
                self._serve(self._interface.open())
            except Exception as error:  # drivers raise errors of many kinds; we try again
                text = " ".join(str(error).split())[:300] or type(error).__name__
                if not isinstance(error, CableSenseError):
                    text = f"{self._interface.name}: {text}"
                self._last_problem = text
                self.ledger.note(FaultKind.INTERFACE_LOST, self._interface.name, text)
            self._connected = False
            if self._reader.frames > before:
                back_off_s = FIRST_BACK_OFF_S
            self._ended.wait(back_off_s)
            back_off_s = min(2.0 * back_off_s, LAST_BACK_OFF_S)

    def _serve(self, bus: can.BusABC) -> None:
        """Receive until the interface is lost or silent."""
        self._openings += 1
        try:
            self._reader.reopened()
            for frame in start_frames(self._map.nmt_start_nodes):
                bus.send(frame)
            self._connected = True
            self._receive(bus)
        finally:
            with contextlib.suppress(Exception):  # closing a lost interface may fail as well
                bus.shutdown()

    def _receive(self, bus: can.BusABC) -> None:
        name = self._interface.name
        last_s = monotonic()
        hold_s = self._reader.hold_s
        while not self._ended.is_set():
            frame = None
            try:
                frame = bus.recv(min(WAKE_S, hold_s))
            except (ValueError, IndexError) as error:  # slcan: a line that is no frame
                self.ledger.note(FaultKind.UNREADABLE, name, f"{name}: {error}")
            now_s = monotonic()
            if frame is not None:
                last_s = now_s
                self._take(frame, bus, now_s)
            elif now_s - last_s >= hold_s:
                self._give(self._reader.lapse(), now_s)
            if now_s - last_s > REOPEN_AFTER_SILENCE_S:
                detail = f"{name}: no frame for {REOPEN_AFTER_SILENCE_S:g} s; it is reopened"
                self.ledger.note(FaultKind.SILENT_BUS, name, detail)
                break

    def _take(self, frame: can.Message, bus: can.BusABC, now_s: float) -> None:
        nodes = self._map.nmt_start_nodes
        node = booted_node(frame, nodes) if nodes else None
        if node is not None:
            bus.send(start_frames([node])[0])
        self._give(self._reader.take(frame, time.time()), now_s)

    def _give(self, sample: AssembledSample | None, now_s: float) -> None:
        if sample is not None:
            self._last_sample_s = now_s
            self._on_sample(sample)


def _sample_verdict(faults: FaultReport, withheld: int, stale_s: float) -> tuple[Level, str]:
    text = "; ".join(
        f"{places.total()} {kind.value} ({some_of(sorted(places), most=4)})"
        for kind, places in faults.recent.items()
    )
    if stale_s:
        return Level.STALE, f"no sample for {stale_s:.1f} s" + (f": {text}" if text else "")
    if withheld:
        return Level.ERROR, f"{withheld} samples withheld: {text or 'not whole'}"
    if faults.recent:
        withholding = any(kind.withholds for kind in faults.recent)
        return Level.ERROR if withholding else Level.WARN, text
    return Level.OK, "every sample whole"
