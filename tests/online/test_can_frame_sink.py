"""Playing frames on a bus, late ones later."""

import can
import pytest

from cablesense_online.can.bus import CanInterface
from cablesense_online.can.emulated_amplifier import PlannedFrame
from cablesense_online.can.emulator import BusSink, play

FRAMES = [can.Message(arbitration_id=n, is_extended_id=False) for n in range(1, 5)]


@pytest.fixture
def buses():
    interface = CanInterface("virtual", "test_can_frame_sink")
    with interface.open() as one, interface.open() as other:
        yield one, other


def test_frames_without_a_wait_go_together():
    course = []

    class Sink:
        def send(self, frames):
            course.append([frame.arbitration_id for frame in frames])

    planned = [PlannedFrame(frame) for frame in FRAMES[:3]] + [PlannedFrame(FRAMES[3], 0.5)]
    play(Sink(), planned, course.append)
    assert course == [[1, 2, 3], 0.5, [4]]


def test_a_bus_takes_frames_and_gives_those_of_others(buses):
    sink = BusSink(buses[0])
    sink.send(FRAMES)
    assert [buses[1].recv(1.0).arbitration_id for _ in FRAMES] == [1, 2, 3, 4]
    buses[1].send(FRAMES[0])
    assert [frame.arbitration_id for frame in sink.received()] == [1]
    assert sink.received() == []


def test_frames_that_the_bus_does_not_take_are_counted(buses, monkeypatch):
    def full(frame):
        raise can.CanOperationError("transmit buffer full")

    sink = BusSink(buses[0])
    monkeypatch.setattr(buses[0], "send", full)
    sink.send(FRAMES)
    assert sink.dropped == 4
