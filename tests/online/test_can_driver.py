"""The driver without ROS, on a virtual bus and on a pseudo-terminal."""

import itertools
import time

import numpy as np
import pytest
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE

from cablesense_msgs_py.diagnostics import Level
from cablesense_online.can.bus import CanInterface
from cablesense_online.can.driver import CanDriver
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
