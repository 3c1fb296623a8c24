"""Serial adapters read in bulk, with a pseudo-terminal in their place."""

import itertools
import os
import time
import tty

import can
import pytest

from cablesense_online.can.slcan import SlcanBus


class Adapter:
    """The adapter's end of the line, without any manners."""

    def __init__(self):
        self.end, self.host_end = os.openpty()
        tty.setraw(self.host_end)
        self.bus = SlcanBus(os.ttyname(self.host_end), sleep_after_open=0.0)

    def say(self, data):
        os.write(self.end, data)

    def close(self):
        self.bus.serialPortOrig.close()
        for end in (self.end, self.host_end):
            if end is not None:
                os.close(end)


@pytest.fixture
def adapter():
    adapter = Adapter()
    yield adapter
    adapter.bus._is_shutdown = True  # it has no adapter to tell
    adapter.close()


def take(adapter, count):
    return [adapter.bus.recv(1.0) for _ in range(count)]


def test_answers_between_frames_are_passed_over(adapter):
    adapter.say(b"\r\rz\r\at1231AA\rZ\r\rt12413B\r")
    frames = take(adapter, 2)
    assert [(f.arbitration_id, bytes(f.data)) for f in frames] == [
        (0x123, b"\xaa"),
        (0x124, b"\x3b"),
    ]
    assert adapter.bus.recv(0.01) is None


def test_a_line_in_two_pieces_is_one_line(adapter):
    adapter.say(b"t1232AA")
    assert adapter.bus.recv(0.02) is None
    adapter.say(b"BB\r")
    assert bytes(take(adapter, 1)[0].data) == b"\xaa\xbb"


def test_a_burst_is_read_whole_and_in_order(adapter):
    numbers = list(range(100))
    adapter.say(b"".join(b"t%03X0\r" % number for number in numbers))
    assert [frame.arbitration_id for frame in take(adapter, 100)] == numbers


def test_frames_bear_the_time_of_reading(adapter):
    began_s = time.time()
    adapter.say(b"t1230\r")
    assert began_s <= take(adapter, 1)[0].timestamp <= time.time()


def test_frames_that_waited_are_spread_over_the_time_since_the_last_reading(adapter):
    adapter.say(b"t1230\r")
    first_s = take(adapter, 1)[0].timestamp
    adapter.say(b"t1230\r" * 50)
    time.sleep(0.1)
    times_s = [frame.timestamp for frame in take(adapter, 50)]
    steps_s = [later - earlier for earlier, later in itertools.pairwise([first_s, *times_s])]
    assert min(steps_s) > 0.5e-3
    assert max(steps_s) < 2.0 * 0.1 / 50 + 0.02
    assert times_s[-1] <= time.time()


def test_stamps_ascend_though_the_clock_stands_still(adapter, monkeypatch):
    monkeypatch.setattr(time, "time", lambda: 1.7e9)
    adapter.say(b"t1230\r" * 20)
    times_s = [frame.timestamp for frame in take(adapter, 20)]
    assert all(later > earlier for earlier, later in itertools.pairwise(times_s))
    monkeypatch.setattr(time, "time", lambda: 1.6e9)  # it was set back
    adapter.say(b"t1230\r")
    assert take(adapter, 1)[0].timestamp < 1.61e9


def test_a_line_that_is_no_frame_raises_once_and_the_next_is_read(adapter):
    adapter.say(b"tXYZ\rt1230\r")
    with pytest.raises(ValueError, match="is no frame"):
        adapter.bus.recv(1.0)
    assert take(adapter, 1)[0].arbitration_id == 0x123


def test_noise_without_end_fills_no_memory(adapter):
    for _ in range(50):
        adapter.say(b"Q" * 100)
        adapter.bus.recv(0.001)
    assert len(adapter.bus._begun) <= 64
    adapter.say(b"\rt1230\r")
    assert take(adapter, 1)[0].arbitration_id == 0x123


def test_flush_forgets_what_was_not_taken(adapter):
    adapter.say(b"t1230\rt1240\rt12")
    take(adapter, 1)
    adapter.bus.flush()
    adapter.say(b"t1250\r")
    assert take(adapter, 1)[0].arbitration_id == 0x125


def test_an_adapter_that_is_gone_raises(adapter):
    os.close(adapter.host_end)
    os.close(adapter.end)
    adapter.host_end = adapter.end = None
    with pytest.raises(can.CanOperationError):
        adapter.bus.recv(0.1)
