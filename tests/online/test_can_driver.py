"""The driver without ROS: receive loop, samples, diagnostics, count of faults."""

import itertools
import time
from queue import Empty, Queue
from threading import Thread
from types import SimpleNamespace

import can
import numpy as np
import pytest
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE

from cablesense_msgs_py.messages import Level
from cablesense_online.can import driver as driver_module
from cablesense_online.can.bus import (
    ELSEWHERE,
    PLACES_KEPT,
    BusCondition,
    CanInterface,
    CanInterfaceError,
    FaultKind,
    FaultLedger,
)
from cablesense_online.can.driver import (
    CanDriver,
    ReceiveLoop,
    SampleCounts,
    interface_status,
    sample_status,
)
from cablesense_online.can.emulated_amplifier import EmulatedAmplifier
from cablesense_online.can.emulator import BusSink, play
from cablesense_online.can.slcan import SlcanPort

TENSIONS_N = np.linspace(40.0, 62.0, 12)
_numbers = itertools.count()


def until(condition):
    end = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


class Bench:
    """A driver that listens, and an amplifier on the other side of a virtual bus."""

    def __init__(self, channel_map, database):
        interface = CanInterface("virtual", f"test_can_driver_{next(_numbers)}")
        self.map = channel_map
        self.samples = []
        self.sink = BusSink(interface.open())
        self.amplifier = EmulatedAmplifier(channel_map, database)
        self.driver = CanDriver(channel_map, database, interface, self.samples.append)
        self.driver.start()
        until(lambda: self.statuses["interface"].values["openings"] == "1")
        time.sleep(0.02)

    def cycles(self, count, tensions_n=TENSIONS_N):
        for _ in range(count):
            for frame in self.sink.received():
                self.amplifier.take(frame)
            play(self.sink, self.amplifier.cycle(tensions_n))
            time.sleep(self.map.cycle_time_s)

    def cycles_until(self, count):
        """Samples of as many cycles as it takes: a pause of this process makes a sample late."""
        wanted = len(self.samples) + count

        def enough():
            self.cycles(1)
            return len(self.samples) >= wanted

        until(enough)

    def request(self, text):
        self.amplifier.request(text)

    @property
    def statuses(self):
        return {status.name: status for status in self.driver.report(0.2)[0]}

    def close(self):
        self.driver.stop()
        self.sink.close()


@pytest.fixture
def packed():
    bench = Bench(PACKED, PACKED_DATABASE)
    yield bench
    bench.close()


@pytest.fixture
def single():
    bench = Bench(SINGLE, SINGLE_DATABASE)
    yield bench
    bench.close()


def test_samples_arrive_stamped_by_the_bus(packed):
    began_s = time.time()
    packed.cycles_until(50)
    times_s = [sample.time_s for sample in packed.samples]
    assert began_s <= min(times_s) < max(times_s) <= time.time()
    assert times_s == sorted(times_s)
    assert np.allclose(packed.samples[0].tensions_n, TENSIONS_N, atol=0.051)
    assert packed.statuses["interface"].level is Level.OK


def test_canopen_nodes_are_started_and_started_again_after_a_loss_of_power(single):
    single.cycles_until(20)
    single.sink.send(single.amplifier.power_up())
    time.sleep(0.1)
    single.cycles_until(20)


def test_a_missing_channel_stops_the_samples_and_is_reported(packed):
    packed.cycles(20)
    packed.request("missing_channel cable_6")
    time.sleep(0.05)
    count = len(packed.samples)
    packed.statuses  # noqa: B018 (a report clears what is recent)
    packed.cycles(20)
    time.sleep(0.1)
    assert len(packed.samples) == count
    samples = packed.statuses["samples"]
    assert samples.level is Level.ERROR
    assert "missing channel (cable_5, cable_6, cable_7, cable_8)" in samples.message


def test_bus_off_is_reported_and_its_end_as_well(packed):
    packed.cycles(5)
    packed.request("bus_off")
    packed.cycles(5)
    time.sleep(0.05)
    interface = packed.statuses["interface"]
    assert (interface.level, interface.values["bus"]) == (Level.ERROR, "bus off")
    packed.request("")
    packed.cycles(5)
    time.sleep(0.05)
    assert packed.statuses["interface"].values["recoveries from bus off"] == "1"


@pytest.mark.slow
def test_an_adapter_that_is_pulled_and_plugged_in_again(tmp_path):
    link = str(tmp_path / "adapter")
    samples, driver = [], None
    amplifier = EmulatedAmplifier(PACKED, PACKED_DATABASE)
    try:
        driver = CanDriver(
            PACKED, PACKED_DATABASE, CanInterface("slcan", link, 1_000_000), samples.append
        )
        driver.start()
        time.sleep(0.1)
        assert "is not open" in driver.report(0.2)[0][0].message
        for _ in range(2):
            port = SlcanPort(link)
            plugged_s = time.monotonic()
            samples.clear()
            while len(samples) < 20:
                assert time.monotonic() - plugged_s < 3.0
                play(port, amplifier.cycle(TENSIONS_N))
                time.sleep(0.01)
            assert np.allclose(samples[-1].tensions_n, TENSIONS_N, atol=0.051)
            port.close()
            time.sleep(0.2)
            interface = driver.report(0.2)[0][0]
            assert interface.level is Level.ERROR
            assert "is not open" in interface.message
    finally:
        if driver is not None:
            driver.stop()


LOOP = SimpleNamespace(name="socketcan can0", connected=True, openings=1, last_problem="")
COUNTS = SampleCounts(frames=4000, samples=1000, withheld=0)


def statuses(recent=COUNTS, total=COUNTS, stale=False, faults=(), **change):
    ledger = FaultLedger()
    for kind, place in faults:
        ledger.note(kind, place)
    samples = sample_status(recent, total, 1.0, 0.3, stale, 3e-4, ledger.report())
    bus = SimpleNamespace(condition=change.pop("condition", BusCondition.ACTIVE), recoveries=0)
    loop = SimpleNamespace(**{**vars(LOOP), **change})
    return interface_status(loop, bus, recent, total, 1.0), samples


def test_all_is_well():
    interface, samples = statuses()
    assert (interface.level, samples.level) == (Level.OK, Level.OK)
    assert interface.values["frames (1/s)"] == "4000"
    assert samples.values["rate (Hz)"] == "1000.0"
    assert samples.values["largest skew (s)"] == "0.000300"


def test_totals_stand_beside_what_is_recent():
    total = SampleCounts(frames=90_000, samples=22_000, withheld=7)
    interface, samples = statuses(total=total)
    assert interface.values["frames in all"] == "90000"
    assert samples.values["samples in all"] == "22000"
    assert samples.values["withheld in all"] == "7"


@pytest.mark.parametrize(
    ("change", "level", "said"),
    [
        ({"connected": False, "last_problem": "device gone"}, Level.ERROR, "device gone"),
        ({"condition": BusCondition.OFF}, Level.ERROR, "off the bus"),
        ({"condition": BusCondition.PASSIVE}, Level.WARN, "error passive"),
    ],
)
def test_an_interface_that_is_not_well_says_how(change, level, said):
    interface, _ = statuses(**change)
    assert interface.level is level
    assert said in interface.message


def test_a_bus_without_frames_is_stale():
    interface, samples = statuses(recent=SampleCounts(), stale=True)
    assert (interface.level, samples.level) == (Level.STALE, Level.STALE)
    assert "no sample for 0.3 s" in samples.message


@pytest.mark.parametrize("kind", FaultKind)
def test_every_fault_is_told_with_its_place_and_counted(kind):
    _, samples = statuses(faults=[(kind, "cable_5"), (kind, "cable_6")])
    assert samples.level in (Level.WARN, Level.ERROR)
    assert f"2 {kind.value} (cable_5, cable_6)" in samples.message
    assert samples.values[f"{kind.value} in all"] == "2"


def test_withheld_samples_are_an_error_and_strange_frames_a_warning():
    _, withheld = statuses(
        recent=SampleCounts(4000, 990, 10), faults=[(FaultKind.MISSING_CHANNEL, "cable_5")]
    )
    _, strange = statuses(faults=[(FaultKind.UNKNOWN_ID, "0x555")])
    assert (withheld.level, strange.level) == (Level.ERROR, Level.WARN)
    assert "10 samples withheld" in withheld.message


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


class LoopBench:
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
    bench = LoopBench()
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
    bench = LoopBench()
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
    bench = LoopBench()
    bench.loop.start()
    bench.until(lambda: bench.loop.openings >= 2)
    bench.loop.stop()
    assert FaultKind.SILENT_BUS in bench.ledger.report().recent


def test_it_ends_at_once_while_the_interface_is_away():
    bench = LoopBench()
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


def test_a_report_covers_the_time_since_the_last_and_totals_go_on():
    ledger = FaultLedger()
    ledger.note(FaultKind.MISSING_CHANNEL, "cable_5")
    ledger.note(FaultKind.MISSING_CHANNEL, "cable_5")
    ledger.note(FaultKind.MISSING_CHANNEL, "cable_7", "cable_7 did not come")
    first, second = ledger.report(), ledger.report()
    assert first.recent == {FaultKind.MISSING_CHANNEL: 3}
    assert first.places[FaultKind.MISSING_CHANNEL] == {"cable_5": 2, "cable_7": 1}
    assert first.last[FaultKind.MISSING_CHANNEL] == "cable_7 did not come"
    assert second.recent == {}
    assert second.total == {FaultKind.MISSING_CHANNEL: 3}


def test_any_number_of_places_takes_little_memory():
    ledger = FaultLedger()
    for number in range(10_000):
        ledger.note(FaultKind.UNKNOWN_ID, hex(number))
    report = ledger.report()
    assert report.recent[FaultKind.UNKNOWN_ID] == 10_000
    assert len(report.places[FaultKind.UNKNOWN_ID]) == PLACES_KEPT + 1
    assert report.places[FaultKind.UNKNOWN_ID][ELSEWHERE] == 10_000 - PLACES_KEPT


def test_two_threads_lose_no_count():
    ledger = FaultLedger()

    def count():
        for _ in range(2_000):
            ledger.note(FaultKind.ERROR_FRAME, "can0")

    threads = [Thread(target=count) for _ in range(2)]
    for thread in threads:
        thread.start()
    seen = 0
    while any(thread.is_alive() for thread in threads):
        seen += ledger.report().recent.get(FaultKind.ERROR_FRAME, 0)
    seen += ledger.report().recent.get(FaultKind.ERROR_FRAME, 0)
    assert seen == ledger.report().total[FaultKind.ERROR_FRAME] == 4_000
