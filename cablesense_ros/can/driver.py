"""The driver without ROS: receives while it runs, hands out samples, reports on itself."""

from __future__ import annotations

import time
from collections.abc import Callable

import can
from cantools.database.can import Database

from cablesense_msgs_py.diagnostics import Status
from cablesense_ros.can.channel_map import ChannelMap
from cablesense_ros.can.driver_report import InterfaceState, SampleCounts, driver_statuses
from cablesense_ros.can.fault_ledger import FaultLedger, FaultReport
from cablesense_ros.can.interface import CanInterface
from cablesense_ros.can.network_management import booted_node, start_frames
from cablesense_ros.can.receive_loop import ReceiveLoop
from cablesense_ros.can.sample_assembler import Sample
from cablesense_ros.can.tension_reader import TensionReader


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
