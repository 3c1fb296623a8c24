"""The driver without ROS: receives while it runs, hands out samples, reports on itself.

From received frames to samples of tensions: everything between the interface and the node.

What the driver says of itself on `/diagnostics`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import can
from cantools.database.can import Database

from cablesense_msgs_py.diagnostics import Level, Status
from cablesense_online.can.bus import CanInterface, booted_node, start_frames
from cablesense_online.can.channel_map import ChannelMap
from cablesense_online.can.decoder import FrameDecoder, Sample, SampleAssembler
from cablesense_online.can.faults import WITHHOLDS, FaultKind, FaultLedger, FaultReport
from cablesense_online.can.receive_loop import ReceiveLoop
from cablesense_online.can.watches import BusClock, BusCondition, BusWatch, FloodWatch, StuckWatch

SCATTER_OF_READING_S = 0.1
"""Skew limit where frames bear the time of reading: any pause of the process would look late. The
order of the frames then bounds the skew, as no channel comes twice in a sample: to one cycle."""


class TensionReader:
    """Takes frames as they come; gives a sample only when all of it can be believed.

    Attributes:
        frames: taken so far, of any kind.
        samples: given so far.
        largest_skew_s: of the samples given since the reporter last set it to zero.
        bus: the condition of the bus.
    """

    def __init__(
        self,
        channel_map: ChannelMap,
        database: Database,
        interface: CanInterface,
        ledger: FaultLedger,
    ) -> None:
        """`interface` is where the frames come from; it is not opened here."""
        self._ledger = ledger
        self._names = channel_map.cable_names
        self._decoder = FrameDecoder(channel_map, database, ledger)
        skew_limit_s = channel_map.skew_limit_s
        if not interface.stamps_frames:
            skew_limit_s = max(skew_limit_s, SCATTER_OF_READING_S)
        self._assembler = SampleAssembler(
            self._names, skew_limit_s, self._decoder.counter_modulo, ledger
        )
        self._stuck = StuckWatch(len(self._names), channel_map.stuck)
        self._clock = BusClock()
        known_frames_s = self._decoder.frames_per_cycle / channel_map.cycle_time_s
        self._flood = FloodWatch(channel_map.flood_frames_s, known_frames_s, ledger)
        self.bus = BusWatch(interface.name, interface.classes_errors, ledger)
        self.frames = 0
        self.samples = 0
        self._stuck_samples = 0
        self._cycle_time_s = channel_map.cycle_time_s
        self._last_frame_s = 0.0
        self.largest_skew_s = 0.0

    @property
    def withheld(self) -> int:
        """Samples not given so far: not whole, late, or not to be believed."""
        return self._assembler.dropped + self._stuck_samples

    def take(self, frame: can.Message, now_s: float, monotonic_s: float) -> Sample | None:
        """Take a frame; give the sample that it completes, if every reading can be believed.

        Args:
            frame: as received.
            now_s: arrival by this machine's clock, s since the epoch.
            monotonic_s: arrival by the monotonic clock.
        """
        self.frames += 1
        self._last_frame_s = monotonic_s
        if frame.is_error_frame:
            self.bus.error_frame(frame.arbitration_id, bytes(frame.data))
            return None
        self.bus.data_frame()
        if not self._flood.admit(self._decoder.knows(frame), monotonic_s):
            return None
        decoded = self._decoder.decode(frame)
        if decoded is None:
            return None
        sample = self._assembler.take(decoded, self._clock.time_s(frame.timestamp, now_s))
        if sample is None or self._has_stuck(sample):
            return None
        self.samples += 1
        self.largest_skew_s = max(self.largest_skew_s, sample.skew_s)
        return sample

    def silence(self, monotonic_s: float) -> None:
        """No frame came for a while; after a whole cycle of it an open sample is given up."""
        if monotonic_s - self._last_frame_s > self._cycle_time_s:
            self._assembler.silence()

    def reopened(self) -> None:
        """The interface was opened again: clocks, counters and condition start anew."""
        self._clock.restart()
        self._assembler.restart()
        self._stuck.restart()
        self.bus.reopened()

    def _has_stuck(self, sample: Sample) -> bool:
        stuck = self._stuck.stuck(sample.tensions_n, sample.time_s)
        for channel in stuck:
            name = self._names[channel]
            self._ledger.note(
                FaultKind.STUCK_VALUE,
                name,
                f"{name} stands at {sample.tensions_n[channel]:g} N while the others move",
            )
        self._stuck_samples += bool(stuck)
        return bool(stuck)


_SHOWN_PLACES = 4


@dataclass(frozen=True)
class SampleCounts:
    """Frames taken, samples given and samples withheld."""

    frames: int = 0
    samples: int = 0
    withheld: int = 0

    def __sub__(self, earlier: SampleCounts) -> SampleCounts:
        return SampleCounts(
            self.frames - earlier.frames,
            self.samples - earlier.samples,
            self.withheld - earlier.withheld,
        )


@dataclass(frozen=True)
class InterfaceState:
    """The interface at present: whether it is open, how often it was, and how the bus stands."""

    name: str
    connected: bool
    openings: int
    last_problem: str
    condition: BusCondition
    recoveries: int


def driver_statuses(
    interface: InterfaceState,
    recent: SampleCounts,
    total: SampleCounts,
    period_s: float,
    silence_s: float,
    stale: bool,
    skew_s: float,
    faults: FaultReport,
) -> list[Status]:
    """The statuses `interface` and `samples`.

    Args:
        interface: at present.
        recent: counts of the last `period_s`.
        total: counts since the node was configured.
        period_s: length of that time.
        silence_s: time since the last sample.
        stale: whether that is too long.
        skew_s: largest of the samples of the period.
        faults: of the period.
    """
    return [
        _interface_status(interface, recent, total, period_s),
        _sample_status(recent, total, period_s, silence_s, stale, skew_s, faults),
    ]


def _interface_status(
    interface: InterfaceState, recent: SampleCounts, total: SampleCounts, period_s: float
) -> Status:
    level, message = Level.OK, f"receiving on {interface.name}"
    if not interface.connected:
        level, message = Level.ERROR, f"{interface.name} is not open: {interface.last_problem}"
    elif interface.condition is BusCondition.OFF:
        level, message = Level.ERROR, "the controller is off the bus and waits to be restarted"
    elif interface.condition is not BusCondition.ACTIVE:
        level, message = Level.WARN, f"the controller is {interface.condition.value}"
    elif not recent.frames:
        level, message = Level.STALE, f"no frame on {interface.name}"
    values = {
        "interface": interface.name,
        "frames (1/s)": f"{recent.frames / period_s:.0f}",
        "frames in all": str(total.frames),
        "bus": interface.condition.value,
        "recoveries from bus off": str(interface.recoveries),
        "openings": str(interface.openings),
    }
    if interface.last_problem:
        values["last problem"] = interface.last_problem
    return Status("interface", level, message, values)


def _sample_status(
    recent: SampleCounts,
    total: SampleCounts,
    period_s: float,
    silence_s: float,
    stale: bool,
    skew_s: float,
    faults: FaultReport,
) -> Status:
    level, message = Level.OK, "every sample whole"
    words = "; ".join(
        f"{count} {kind.value} ({_listed(faults.places[kind])})"
        for kind, count in faults.recent.items()
    )
    if stale:
        level = Level.STALE
        message = f"no sample for {silence_s:.1f} s" + (f": {words}" if words else "")
    elif recent.withheld or WITHHOLDS & set(faults.recent):
        level, message = Level.ERROR, words
        if recent.withheld:
            message = f"{recent.withheld} samples withheld: {words or 'not whole'}"
    elif faults.recent:
        level, message = Level.WARN, words
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


def _listed(places: Mapping[str, int]) -> str:
    shown = ", ".join(sorted(places)[:_SHOWN_PLACES])
    more = len(places) - _SHOWN_PLACES
    return f"{shown} and {more} more" if more > 0 else shown


class CanDriver:
    """Joins the receiving thread, the reader, and what CANopen amplifiers want to be told.

    Nodes of the map's `nmt_start_nodes` are started whenever the interface is opened, and each
    again when its boot-up message says that it lost power.
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
        self._name = interface.name
        self._send: Callable[[can.Message], None] | None = None
        self._last_sample_s = self._report_s = time.monotonic()
        self._reported = SampleCounts()

    def start(self) -> None:
        """Begin to receive; an interface that is not there is waited for."""
        self._last_sample_s = self._report_s = time.monotonic()
        self._loop.start()

    def stop(self) -> None:
        """Receive no more, and close the interface."""
        self._loop.stop()

    def opened(self, send: Callable[[can.Message], None]) -> None:
        """The interface is open (called by the loop)."""
        self._reader.reopened()
        self._send = send
        for frame in start_frames(self._nodes):
            send(frame)

    def received(self, frame: can.Message) -> None:
        """A frame came (called by the loop)."""
        monotonic_s = time.monotonic()
        if self._nodes and self._send is not None:
            node = booted_node(frame, self._nodes)
            if node is not None:
                self._send(start_frames([node])[0])
        sample = self._reader.take(frame, time.time(), monotonic_s)
        if sample is not None:
            self._last_sample_s = monotonic_s
            self._on_sample(sample)

    def silence(self) -> None:
        """No frame for a while (called by the loop)."""
        self._reader.silence(time.monotonic())

    def report(self, stale_after_s: float) -> tuple[list[Status], FaultReport]:
        """The driver's health and faults since this was last asked.

        Args:
            stale_after_s: without a sample for so long, samples count as stale.
        """
        now_s = time.monotonic()
        reader, faults = self._reader, self._ledger.report()
        counts = SampleCounts(reader.frames, reader.samples, reader.withheld)
        recent, self._reported = counts - self._reported, counts
        skew_s, reader.largest_skew_s = reader.largest_skew_s, 0.0
        interface = InterfaceState(
            self._name,
            self._loop.connected,
            self._loop.openings,
            self._loop.last_problem,
            reader.bus.condition,
            reader.bus.recoveries,
        )
        period_s, self._report_s = max(now_s - self._report_s, 1e-9), now_s
        silence_s = now_s - self._last_sample_s
        statuses = driver_statuses(
            interface,
            recent,
            counts,
            period_s,
            silence_s,
            silence_s > stale_after_s,
            skew_s,
            faults,
        )
        return statuses, faults
