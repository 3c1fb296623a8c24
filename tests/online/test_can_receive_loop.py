"""The receiving thread outlives every loss of its interface."""

import time
from queue import Empty, Queue

import can
import pytest

from cablesense_online.can import driver as driver_module
from cablesense_online.can.bus import CanInterfaceError
from cablesense_online.can.driver import ReceiveLoop
from cablesense_online.can.faults import FaultKind, FaultLedger

FRAME = can.Message(arbitration_id=1, is_extended_id=False)


class FakeBus:
    """Gives what is put into it; an exception put in is raised."""

    def __init__(self):
        self.coming = Queue()
        self.sent = []
        self.closed = False

    def recv(self, timeout):
        try:
            item = self.coming.get(timeout=timeout)
        except Empty:
            return None
        if isinstance(item, Exception):
            raise item
        return item

    def send(self, frame):
        self.sent.append(frame)

    def shutdown(self):
        self.closed = True
        raise OSError("closing what is gone fails")


class Receiver:
    def __init__(self):
        self.frames, self.silences, self.openings = 0, 0, 0

    def opened(self, send):
        self.openings += 1
        send(FRAME)

    def received(self, frame):
        self.frames += 1

    def silence(self):
        self.silences += 1


class Bench:
    def __init__(self):
        self.buses, self.shut = [], False
        self.receiver, self.ledger = Receiver(), FaultLedger()
        self.loop = ReceiveLoop("fake", self.open, self.receiver, self.ledger)

    def open(self):
        if self.shut:
            raise CanInterfaceError("fake is not there")
        self.buses.append(FakeBus())
        return self.buses[-1]

    def until(self, condition):
        end = time.monotonic() + 5.0
        while not condition():
            assert time.monotonic() < end
            time.sleep(0.005)


@pytest.fixture
def bench():
    bench = Bench()
    bench.loop.start()
    bench.until(lambda: bench.loop.connected)
    yield bench
    bench.loop.stop()
    assert not bench.loop.connected
    assert all(bus.closed for bus in bench.buses)


def test_frames_are_passed_on_and_the_bus_can_be_sent_on(bench):
    for _ in range(10):
        bench.buses[0].coming.put(FRAME)
    bench.until(lambda: bench.receiver.frames == 10)
    assert bench.buses[0].sent == [FRAME]
    bench.until(lambda: bench.receiver.silences > 0)


@pytest.mark.parametrize(
    "error", [OSError("device gone"), can.CanOperationError("down"), RuntimeError("driver")]
)
def test_an_interface_that_vanishes_is_opened_again_until_it_is_there(bench, error):
    bench.shut = True
    bench.buses[0].coming.put(error)
    bench.until(lambda: bench.ledger.report().total.get(FaultKind.INTERFACE_LOST, 0) >= 3)
    assert not bench.loop.connected
    assert bench.loop.last_problem == "fake is not there"
    bench.shut = False
    began_s = time.monotonic()
    bench.until(lambda: bench.loop.connected)
    assert time.monotonic() - began_s < 2.0
    bench.buses[-1].coming.put(FRAME)
    bench.until(lambda: bench.receiver.frames == 1)
    assert bench.receiver.openings == bench.loop.openings == 2


def test_one_wait_in_vain_is_no_silence():
    bench = Bench()
    bus = FakeBus()
    course = iter([FRAME, None, FRAME, None, FRAME, None, None, None])
    heard = []

    def recv(timeout):
        item = next(course, "end")
        if item == "end":
            bench.loop._ended.set()
            return None
        heard.append((item is not None, bench.receiver.silences))
        return item

    bus.recv = recv
    bench.loop._receive(bus)
    assert [silences for _, silences in heard] == [0, 0, 0, 0, 0, 0, 0, 1]


def test_a_line_that_is_no_frame_is_counted_and_the_next_one_taken(bench):
    for item in (ValueError("not hexadecimal"), FRAME, IndexError("too short"), FRAME):
        bench.buses[0].coming.put(item)
    bench.until(lambda: bench.receiver.frames == 2)
    assert bench.ledger.report().recent == {FaultKind.UNREADABLE: 2}
    assert bench.loop.openings == 1


def test_an_adapter_out_of_step_is_opened_again(bench):
    for _ in range(driver_module.UNREADABLE_IN_A_ROW):
        bench.buses[0].coming.put(ValueError("not hexadecimal"))
    bench.until(lambda: bench.loop.openings == 2)


def test_a_silent_interface_is_opened_again(monkeypatch):
    monkeypatch.setattr(driver_module, "REOPEN_AFTER_SILENCE_S", 0.1)
    bench = Bench()
    bench.loop.start()
    bench.until(lambda: bench.loop.openings >= 2)
    bench.loop.stop()
    assert FaultKind.SILENT_BUS in bench.ledger.report().recent


def test_it_ends_at_once_while_the_interface_is_away():
    bench = Bench()
    bench.shut = True
    bench.loop.start()
    bench.until(lambda: bench.ledger.report().total.get(FaultKind.INTERFACE_LOST, 0) >= 2)
    began_s = time.monotonic()
    bench.loop.stop()
    bench.loop.stop()
    assert time.monotonic() - began_s < 1.0


def test_it_can_be_started_again_after_it_ended(bench):
    bench.loop.stop()
    bench.loop.start()
    bench.until(lambda: bench.loop.openings == 2)
