"""The thread that receives: opens the interface, reads it, and opens it again when it is lost.

python-can's own Notifier ends for good at the first error, so it is not used.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from time import monotonic
from typing import Protocol

import can

from cablesense_base.errors import CableSenseError
from cablesense_online.can.faults import FaultKind, FaultLedger

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


class Receives(Protocol):
    """What the loop tells of."""

    def opened(self, send: Callable[[can.Message], None]) -> None:
        """The interface is open; `send` sends a frame on it."""

    def received(self, frame: can.Message) -> None:
        """A frame came."""

    def silence(self) -> None:
        """No frame in the last two waits of `WAKE_S`."""


class ReceiveLoop:
    """Runs the thread between `start` and `stop`.

    Attributes:
        connected: whether the interface is open now.
        openings: how often it was opened so far.
        last_problem: why it was lost, or could not be opened, the last time.
    """

    def __init__(
        self,
        name: str,
        open_bus: Callable[[], can.BusABC],
        receiver: Receives,
        ledger: FaultLedger,
    ) -> None:
        """`open_bus` raises when the interface cannot be opened; `name` names it in faults."""
        self._name = name
        self._open_bus = open_bus
        self._receiver = receiver
        self._ledger = ledger
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        self._heard = False
        self.connected = False
        self.openings = 0
        self.last_problem = ""

    def start(self) -> None:
        """Begin to receive, in a thread of its own."""
        self._ended.clear()
        self._thread = threading.Thread(
            target=self._run, name=f"receive {self._name}", daemon=True
        )
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
            self._heard = False
            try:
                bus = self._open_bus()
            except Exception as error:  # whatever keeps it shut, it is tried again
                self._lost(error)
            else:
                self._serve(bus)
            if self._heard:
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
                self._ledger.note(FaultKind.UNREADABLE, self._name, f"{self._name}: {error}")
                if unreadable >= UNREADABLE_IN_A_ROW:
                    raise
                continue
            if frame is not None:
                unreadable, in_vain = 0, 0
                last_s, self._heard = monotonic(), True
                self._receiver.received(frame)
                continue
            in_vain += 1
            if in_vain < WAITS_OF_SILENCE:
                continue
            self._receiver.silence()
            if monotonic() - last_s > REOPEN_AFTER_SILENCE_S:
                self._ledger.note(
                    FaultKind.SILENT_BUS,
                    self._name,
                    f"{self._name}: no frame for {REOPEN_AFTER_SILENCE_S:g} s; it is opened anew",
                )
                break

    def _lost(self, error: Exception) -> None:
        words = " ".join(str(error).split())[:300] or type(error).__name__
        self.last_problem = (
            words if isinstance(error, CableSenseError) else f"{self._name}: {words}"
        )
        self._ledger.note(FaultKind.INTERFACE_LOST, self._name, self.last_problem)
