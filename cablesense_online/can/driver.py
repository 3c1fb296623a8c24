"""The CAN driver without ROS: a receiving thread, samples handed out, its diagnostics.

python-can's own Notifier thread ends for good at the first error, so the receive loop is our own:
it opens the interface again when it is lost.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import astuple, dataclass
from time import monotonic

import can
import numpy as np
from cantools.database.can import Database

from cablesense_base.errors import CableSenseError, some_of
from cablesense_msgs_py.messages import Level, Status
from cablesense_online.can.bus import (
    BusCondition,
    BusState,
    CanInterface,
    FaultKind,
    FaultLedger,
    FaultReport,
    booted_node,
    start_frames,
)
from cablesense_online.can.channel_map import ChannelMap
from cablesense_online.can.decoder import Sample
from cablesense_online.can.tension_reader import TensionReader

FIRST_BACK_OFF_S = 0.05
LAST_BACK_OFF_S = 0.5
"""Short enough that samples are there again within a second of the interface's return."""

WAKE_S = 0.05
WAITS_OF_SILENCE = 2
"""The first wait may have ended in a pause of this process, with frames already there: only what
the next one still does not find has not come."""

REOPEN_AFTER_SILENCE_S = 2.0
"""Adapters that lost power at times neither raise nor deliver; opening them anew sets them up."""

UNREADABLE_IN_A_ROW = 10
"""So many lines that are no frames, one after the other, are an adapter out of step."""


class CanDriver:
    """Joins the receiving thread, the reader, and the starts that CANopen amplifiers need.

    Nodes of the map's `nmt_start_nodes` are started whenever the interface is opened, and each
    again when its boot-up message shows that it lost power.
    """

    def __init__(
        self,
        channel_map: ChannelMap,
        database: Database,
        interface: CanInterface,
        on_sample: Callable[[Sample], None],
    ) -> None:
        """`on_sample` is called in the receiving thread."""
        self._nodes = tuple(channel_map.nmt_start_nodes)
        self._on_sample = on_sample
        self._ledger = FaultLedger()
        self._reader = TensionReader(channel_map, database, interface, self._ledger)
        self._loop = ReceiveLoop(interface.name, interface.open, self, self._ledger)
        self._send: Callable[[can.Message], None] | None = None
        self._last_sample_s = self._report_s = monotonic()
        self._reported = SampleCounts()

    def start(self) -> None:
        """Begin to receive; an interface that is not there is waited for."""
        self._last_sample_s = self._report_s = monotonic()
        self._loop.start()

    def stop(self) -> None:
        """Receive no more, and close the interface."""
        self._loop.stop()

    def opened(self, send: Callable[[can.Message], None]) -> None:
        """The interface is open; `send` sends a frame on it (called by the loop)."""
        self._reader.reopened()
        self._send = send
        for frame in start_frames(self._nodes):
            send(frame)

    def received(self, frame: can.Message) -> None:
        """A frame came (called by the loop)."""
        monotonic_s = monotonic()
        if self._nodes and self._send is not None:
            node = booted_node(frame, self._nodes)
            if node is not None:
                self._send(start_frames([node])[0])
        sample = self._reader.take(frame, time.time(), monotonic_s)
        if sample is not None:
            self._last_sample_s = monotonic_s
            self._on_sample(sample)

    def silence(self) -> None:
        """No frame in the last two waits of `WAKE_S` (called by the loop)."""
        self._reader.silence(monotonic())

    def report(self, stale_after_s: float) -> tuple[list[Status], FaultReport]:
        """Health and faults since the report before; samples are stale after so long without."""
        now_s = monotonic()
        reader, loop, faults = self._reader, self._loop, self._ledger.report()
        counts = SampleCounts(reader.frames, reader.samples, reader.withheld)
        recent, self._reported = counts - self._reported, counts
        skew_s, reader.largest_skew_s = reader.largest_skew_s, 0.0
        period_s, self._report_s = max(now_s - self._report_s, 1e-9), now_s
        silence_s = now_s - self._last_sample_s
        stale = silence_s > stale_after_s
        samples = sample_status(recent, counts, period_s, silence_s, stale, skew_s, faults)
        return [interface_status(loop, reader.bus, recent, counts, period_s), samples], faults


class ReceiveLoop:
    """A thread between `start` and `stop` that opens, reads and reopens an interface.

    Attributes:
        name: of the interface.
        connected: whether the interface is open now.
        openings: how often it was opened so far.
        last_problem: why it was lost, or could not be opened, the last time.
    """

    def __init__(
        self,
        name: str,
        open_bus: Callable[[], can.BusABC],
        receiver: CanDriver,
        ledger: FaultLedger,
    ) -> None:
        """`open_bus` raises when the interface cannot be opened; `name` names it in faults."""
        self.name = name
        self._open_bus = open_bus
        self._receiver = receiver
        self._ledger = ledger
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        self._any_frame = False
        self.connected = False
        self.openings = 0
        self.last_problem = ""

    def start(self) -> None:
        """Begin to receive, in a thread of its own."""
        self._ended.clear()
        self._thread = threading.Thread(target=self._run, name=f"receive {self.name}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the interface; safe to call twice."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
            self._thread = None

    def _run(self) -> None:
        back_off_s = FIRST_BACK_OFF_S
        while not self._ended.is_set():
            self._any_frame = False
            try:
                bus = self._open_bus()
            except Exception as error:  # whatever keeps it shut, it is tried again
                self._lost(error)
            else:
                self._serve(bus)
            if self._any_frame:
                back_off_s = FIRST_BACK_OFF_S
            self._ended.wait(back_off_s)
            back_off_s = min(2.0 * back_off_s, LAST_BACK_OFF_S)

    def _serve(self, bus: can.BusABC) -> None:
        """Receive until the interface is lost."""
        self.openings += 1
        try:
            self._receiver.opened(bus.send)
            self.connected = True
            self._receive(bus)
        except Exception as error:  # drivers raise errors of many kinds when a device is pulled
            self._lost(error)
        finally:
            self.connected = False
            with contextlib.suppress(Exception):  # closing what is gone may fail as well
                bus.shutdown()

    def _receive(self, bus: can.BusABC) -> None:
        last_s, unreadable, in_vain = monotonic(), 0, 0
        while not self._ended.is_set():
            try:
                frame = bus.recv(WAKE_S)
            except (ValueError, IndexError) as error:  # slcan: a line that is no frame
                unreadable += 1
                self._ledger.note(FaultKind.UNREADABLE, self.name, f"{self.name}: {error}")
                if unreadable >= UNREADABLE_IN_A_ROW:
                    raise
                continue
            if frame is not None:
                unreadable, in_vain = 0, 0
                last_s, self._any_frame = monotonic(), True
                self._receiver.received(frame)
                continue
            in_vain += 1
            if in_vain < WAITS_OF_SILENCE:
                continue
            self._receiver.silence()
            if monotonic() - last_s > REOPEN_AFTER_SILENCE_S:
                self._ledger.note(
                    FaultKind.SILENT_BUS,
                    self.name,
                    f"{self.name}: no frame for {REOPEN_AFTER_SILENCE_S:g} s; it is opened anew",
                )
                break

    def _lost(self, error: Exception) -> None:
        text = " ".join(str(error).split())[:300] or type(error).__name__
        self.last_problem = text if isinstance(error, CableSenseError) else f"{self.name}: {text}"
        self._ledger.note(FaultKind.INTERFACE_LOST, self.name, self.last_problem)


@dataclass(frozen=True)
class SampleCounts:
    """Frames taken, samples given and samples withheld."""

    frames: int = 0
    samples: int = 0
    withheld: int = 0

    def __sub__(self, earlier: SampleCounts) -> SampleCounts:
        return SampleCounts(*np.subtract(astuple(self), astuple(earlier)).tolist())


def interface_status(
    loop: ReceiveLoop, bus: BusState, recent: SampleCounts, total: SampleCounts, period_s: float
) -> Status:
    """The status `interface`; counts of the last `period_s`, and since the node was configured."""
    level, message = Level.OK, f"receiving on {loop.name}"
    if not loop.connected:
        level, message = Level.ERROR, f"{loop.name} is not open: {loop.last_problem}"
    elif bus.condition is BusCondition.OFF:
        level, message = Level.ERROR, "the controller is off the bus and waits to be restarted"
    elif bus.condition is not BusCondition.ACTIVE:
        level, message = Level.WARN, f"the controller is {bus.condition.value}"
    elif not recent.frames:
        level, message = Level.STALE, f"no frame on {loop.name}"
    values = {
        "interface": loop.name,
        "frames (1/s)": f"{recent.frames / period_s:.0f}",
        "frames in all": str(total.frames),
        "bus": bus.condition.value,
        "recoveries from bus off": str(bus.recoveries),
        "openings": str(loop.openings),
    }
    if loop.last_problem:
        values["last problem"] = loop.last_problem
    return Status("interface", level, message, values)


def sample_status(
    recent: SampleCounts,
    total: SampleCounts,
    period_s: float,
    silence_s: float,
    stale: bool,
    skew_s: float,
    faults: FaultReport,
) -> Status:
    """The status `samples`.

    Args:
        recent: counts of the last `period_s`.
        total: since the node was configured.
        period_s: see `recent`.
        silence_s: time since the last sample.
        stale: whether that is too long.
        skew_s: largest of the samples of the period.
        faults: of the period.
    """
    level, message = Level.OK, "every sample whole"
    text = "; ".join(
        f"{count} {kind.value} ({some_of(sorted(faults.places[kind]), most=4)})"
        for kind, count in faults.recent.items()
    )
    if stale:
        level = Level.STALE
        message = f"no sample for {silence_s:.1f} s" + (f": {text}" if text else "")
    elif recent.withheld:
        level, message = Level.ERROR, f"{recent.withheld} samples withheld: {text or 'not whole'}"
    elif faults.recent:
        level = Level.ERROR if any(kind.withholds for kind in faults.recent) else Level.WARN
        message = text
    values = {
        "rate (Hz)": f"{recent.samples / period_s:.1f}",
        "samples in all": str(total.samples),
        "withheld": str(recent.withheld),
        "withheld in all": str(total.withheld),
        "largest skew (s)": f"{skew_s:.6f}",
    }
    values |= {f"{kind.value} in all": str(faults.total.get(kind, 0)) for kind in FaultKind}
    values |= {f"last {kind.value}": detail for kind, detail in faults.last.items()}
    return Status("samples", level, message, values)
