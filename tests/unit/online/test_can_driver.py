"""The driver without ROS: receive loop, samples, diagnostics, count of faults."""

import itertools
import time
from queue import Empty, Queue

import can
import numpy as np
import pytest

from cablesense_msgs_py.messages import Level
from cablesense_online.can import driver as driver_module
from cablesense_online.can.bus import CanInterface, CanInterfaceError, FaultKind
from cablesense_online.can.driver import CanDriver
from cablesense_online.can.emulator import Emulator, SlcanPort
from tests.helpers.can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE, packed_cycle
from tests.helpers.waiting import until

TENSIONS_N = np.linspace(40.0, 62.0, 12)
_numbers = itertools.count()


class Bench:
    """A driver, and an amplifier on the other side of a virtual bus."""

    def __init__(self, channel_map, database):
        interface = CanInterface("virtual", f"test_can_driver_{next(_numbers)}")
        self.map = channel_map
        self.samples = []
        self.emulator = Emulator(channel_map, database, interface.open)
        self.driver = CanDriver(channel_map, database, interface, self.samples.append)
        self.driver.start()
        until(lambda: self.statuses["interface"].level is not Level.ERROR)

    def cycle(self):
        self.emulator.cycle(TENSIONS_N)
        time.sleep(self.map.cycle_time_s)

    def cycles_until(self, condition):
        """Cycles for as long as it takes: a pause of this process makes a sample late."""

        def met():
            self.cycle()
            return condition()

        until(met)

    def cycles_until_samples(self, count):
        wanted = len(self.samples) + count
        self.cycles_until(lambda: len(self.samples) >= wanted)

    @property
    def statuses(self):
        return {status.name: status for status in self.driver.report(60.0)[0]}

    def close(self):
        self.driver.stop()
        self.emulator.close()


@pytest.fixture
def single():
    bench = Bench(SINGLE, SINGLE_DATABASE)
    yield bench
    bench.close()


def test_canopen_nodes_are_started_and_started_again_after_a_loss_of_power(single):
    single.cycles_until_samples(5)
    single.emulator.request("interface_lost")
    single.emulator.request("")  # plugged in again, the nodes boot
    single.cycles_until_samples(5)


def test_an_adapter_that_is_pulled_and_plugged_in_again(tmp_path):
    link = str(tmp_path / "adapter")
    samples = []
    emulator = None
    driver = CanDriver(
        PACKED, PACKED_DATABASE, CanInterface("slcan", link, 1_000_000), samples.append
    )

    def closed():
        interface = driver.report(0.2)[0][0]
        return interface.level is Level.ERROR and "is not open" in interface.message

    def received():
        emulator.cycle(TENSIONS_N)
        return len(samples) >= 5

    try:
        driver.start()
        until(closed)
        for _ in range(2):
            emulator = Emulator(PACKED, PACKED_DATABASE, lambda: SlcanPort(link))
            samples.clear()
            until(received)
            assert np.allclose(samples[-1].tensions_n, TENSIONS_N, atol=0.051)
            emulator.close()
            until(closed)
    finally:
        driver.stop()


FRAME = can.Message(arbitration_id=0x555, is_extended_id=False)


def error_frame(number, data=bytes(8)):
    return can.Message(arbitration_id=number, is_extended_id=False, is_error_frame=True, data=data)


class FakeBus:
    """Gives what is put into it; an exception put in is raised."""

    def __init__(self):
        self.coming = Queue()
        self.closed = False

    def put(self, *items):
        for item in items:
            self.coming.put(item)

    def recv(self, timeout):
        try:
            item = self.coming.get(timeout=timeout)
        except Empty:
            return None
        if isinstance(item, Exception):
            raise item
        return item

    def shutdown(self):
        self.closed = True
        raise OSError("closing what is gone fails")


class FakeInterface:
    name = "fake"
    stamps_frames = True
    classes_errors = True

    def __init__(self):
        self.buses = []
        self.away = False

    def open(self):
        if self.away:
            raise CanInterfaceError("fake is not there")
        self.buses.append(FakeBus())
        return self.buses[-1]


class FakeBench:
    def __init__(self):
        self.interface = FakeInterface()
        self.samples = []
        self.driver = CanDriver(PACKED, PACKED_DATABASE, self.interface, self.samples.append)

    def report(self, stale_after_s=60.0):
        (interface, samples), _ = self.driver.report(stale_after_s)
        return interface, samples

    def values(self):
        interface, samples = self.report()
        return interface.values | samples.values

    def until_frames(self, count):
        until(lambda: self.values()["frames in all"] == str(count))

    @property
    def openings(self):
        return int(self.values()["openings"])


@pytest.fixture
def idle():
    bench = FakeBench()
    yield bench
    bench.driver.stop()
    assert all(bus.closed for bus in bench.interface.buses)


@pytest.fixture
def bench(idle):
    idle.driver.start()
    until(lambda: idle.report()[0].level is not Level.ERROR)
    return idle


def test_a_report_holds_rates_of_its_period_and_totals(bench):
    frames = [packed_cycle(TENSIONS_N, n, 100.0 + n * 1e-3) for n in range(10)]
    bench.interface.buses[0].put(*itertools.chain(*frames))
    until(lambda: len(bench.samples) == 10)
    interface, samples = bench.report()
    assert (interface.level, samples.level) == (Level.OK, Level.OK)
    assert float(interface.values["frames (1/s)"]) >= float(samples.values["rate (Hz)"]) > 0.0
    assert 0.0 < float(samples.values["largest skew (s)"]) <= PACKED.skew_limit_s
    interface, samples = bench.report(stale_after_s=0.0)
    assert (interface.level, samples.level) == (Level.STALE, Level.STALE)
    assert "no sample for" in samples.message
    assert (interface.values["frames (1/s)"], samples.values["rate (Hz)"]) == ("0", "0.0")
    assert interface.values["frames in all"] == "40"
    assert samples.values["samples in all"] == "10"
    assert samples.values["largest skew (s)"] == "0.000000"


@pytest.mark.parametrize(
    ("frame", "level", "message"),
    [
        (error_frame(0x40), Level.ERROR, "off the bus"),
        (error_frame(0x04, bytes([0, 0x10])), Level.WARN, "error passive"),
    ],
)
def test_the_controllers_error_state_is_reported(bench, frame, level, message):
    bench.interface.buses[0].put(frame)
    until(lambda: message in bench.report()[0].message)
    assert bench.report()[0].level is level


@pytest.mark.parametrize("kind", FaultKind)
def test_every_fault_is_reported_with_its_place_and_counted(idle, kind):
    for cable in ("cable_5", "cable_6"):
        idle.driver.ledger.note(kind, cable)
    _, samples = idle.report()
    assert samples.level is (Level.ERROR if kind.withholds else Level.WARN)
    assert f"2 {kind.value} (cable_5, cable_6)" in samples.message
    assert samples.values[f"{kind.value} in all"] == "2"


@pytest.mark.parametrize(
    "error", [OSError("device gone"), can.CanOperationError("down"), RuntimeError("driver")]
)
def test_an_interface_that_vanishes_is_opened_again_until_it_is_there(bench, error):
    bench.interface.away = True
    bench.interface.buses[0].put(error)
    until(lambda: int(bench.values()["interface lost in all"]) >= 2)
    interface, _ = bench.report()
    assert interface.level is Level.ERROR
    assert interface.message == "fake is not open: fake is not there"
    bench.interface.away = False
    until(lambda: bench.report()[0].level is not Level.ERROR)
    bench.interface.buses[-1].put(FRAME)
    bench.until_frames(1)
    assert bench.openings == 2


def test_a_second_sender_is_named_until_the_driver_is_started_again(bench):
    cycles = [packed_cycle(TENSIONS_N, n, 100.0 + n * 1e-3) for n in range(10)]
    cycles[4].insert(3, packed_cycle(TENSIONS_N + 5.0, 4, 100.004)[3])
    bench.interface.buses[0].put(*itertools.chain(*cycles))
    until(lambda: "distrusted id (TENSIONS_9_TO_12 (0x123))" in bench.report()[1].message)
    bench.until_frames(41)
    assert len(bench.samples) == 4
    bench.driver.stop()
    bench.driver.start()
    until(lambda: len(bench.interface.buses) == 2)
    bench.interface.buses[1].put(*itertools.chain(*cycles[:4]))
    until(lambda: len(bench.samples) == 8)


def test_a_silent_interface_is_opened_again(bench, monkeypatch):
    monkeypatch.setattr(driver_module, "REOPEN_AFTER_SILENCE_S", 0.1)
    until(lambda: bench.openings >= 2)
    assert bench.values()["silent bus in all"] != "0"
