"""The emulator on a sink: cycles, faults, and an interface that is pulled."""

import pytest
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE

from cablesense_online.can.bus import start_frames
from cablesense_online.can.emulated_amplifier import FaultRequestError
from cablesense_online.can.emulator import Emulator

TENSIONS_N = [50.0] * 12


class Sink:
    def __init__(self):
        self.sent, self.coming, self.closed, self.dropped = [], [], False, 0

    def send(self, frames):
        self.sent += frames

    def received(self):
        coming, self.coming = self.coming, []
        return coming

    def close(self):
        self.closed = True


class Bench:
    def __init__(self, channel_map=PACKED, database=PACKED_DATABASE):
        self.sinks = []
        self.emulator = Emulator(channel_map, database, self.open)

    def open(self):
        self.sinks.append(Sink())
        return self.sinks[-1]


@pytest.fixture
def bench():
    return Bench()


def test_every_set_of_tensions_is_one_cycle(bench):
    for _ in range(3):
        bench.emulator.cycle(TENSIONS_N)
    numbers = [frame.arbitration_id for frame in bench.sinks[0].sent]
    assert numbers == [0x120, 0x121, 0x122, 0x123] * 3
    assert bench.emulator.cycles == 3


def test_canopen_nodes_boot_and_wait_to_be_started():
    bench = Bench(SINGLE, SINGLE_DATABASE)
    sink = bench.sinks[0]
    assert [frame.arbitration_id for frame in sink.sent] == list(range(0x701, 0x70D))
    bench.emulator.cycle(TENSIONS_N)
    assert len(sink.sent) == 12
    sink.coming = start_frames(range(1, 13))
    bench.emulator.cycle(TENSIONS_N)
    assert len(sink.sent) == 24


def test_an_interface_is_pulled_and_plugged_in_again_on_request(bench):
    bench.emulator.request("interface_lost")
    assert bench.sinks[0].closed
    bench.emulator.cycle(TENSIONS_N)
    assert bench.emulator.dropped == 0
    bench.emulator.request("")
    bench.emulator.cycle(TENSIONS_N)
    assert len(bench.sinks[1].sent) == 4
    bench.emulator.close()
    bench.emulator.close()
    assert bench.sinks[1].closed


def test_a_fault_that_cannot_be_is_refused_and_changes_nothing(bench):
    bench.emulator.request(" missing_channel  cable_1 ")
    for wrong in ("explosion", "not_finite cable_2"):
        with pytest.raises(FaultRequestError):
            bench.emulator.check(wrong)
        with pytest.raises(FaultRequestError):
            bench.emulator.request(wrong)
    bench.emulator.check("")
    assert bench.emulator.fault == "missing_channel  cable_1"
    bench.emulator.cycle(TENSIONS_N)
    assert [f.arbitration_id for f in bench.sinks[0].sent] == [0x120, 0x122, 0x123]
