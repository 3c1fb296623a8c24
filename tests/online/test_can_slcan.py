"""The slcan protocol: lines, the host's end in bulk, the adapter's end on a pseudo-terminal."""

import itertools
import os
import time
import tty

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cablesense_online.can.bus import CanInterface
from cablesense_online.can.slcan import SlcanBus, SlcanPort, SlcanPortError, frame_line, line_frame


@pytest.mark.parametrize(
    ("line", "number", "data"),
    [
        (b"t1234AABBCCDD", 0x123, b"\xaa\xbb\xcc\xdd"),
        (b"T1ABCDEF01FF", 0x1ABCDEF0, b"\xff"),
        (b"t7FF0", 0x7FF, b""),
        (b"t10021133ABCD", 0x100, b"\x11\x33"),  # with a stamp behind
    ],
)
def test_lines_of_the_manual(line, number, data):
    frame = line_frame(line, 5.0)
    assert (frame.arbitration_id, bytes(frame.data)) == (number, data)
    assert frame.is_extended_id == line.startswith(b"T")
    assert frame.timestamp == 5.0


@given(st.integers(0, 2**29 - 1), st.binary(max_size=8), st.booleans(), st.booleans())
def test_any_frame_comes_back_from_its_line(number, data, extended, remote):
    extended = extended or number > 0x7FF
    frame = can.Message(
        arbitration_id=number,
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=len(data),
        data=None if remote else data,
    )
    assert line_frame(frame_line(frame)).equals(frame, timestamp_delta=None)


def test_error_and_fd_frames_have_no_line():
    assert frame_line(can.Message(is_error_frame=True)) is None
    assert frame_line(can.Message(is_fd=True, data=bytes(12))) is None


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"t",
        b"t123",
        b"t1239",
        b"t1232AA",
        b"t1231GG",
        b"tFFF0",
        b"TFFFFFFFF0",
        b"x1230",
        b"t1_30",
        b"t+120",
    ],
)
def test_a_line_that_is_no_frame_is_shown(line):
    with pytest.raises(ValueError, match="is no frame"):
        line_frame(line)


@given(st.binary(max_size=40))
def test_any_bytes_are_a_frame_or_refused(line):
    try:
        frame = line_frame(line)
    except ValueError:
        return
    assert len(frame.data) <= 8


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
    adapter.bus._is_shutdown = True  # it has no adapter to close
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


@pytest.fixture
def port():
    port = SlcanPort()
    yield port
    port.close()


def host_of(port):
    host = CanInterface("slcan", port.path, 1_000_000).open()
    until(lambda: port.channel_open)
    return host


def until(condition):
    end = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def receive(host, count):
    frames, end = [], time.monotonic() + 5.0
    while len(frames) < count and time.monotonic() < end:
        frame = host.recv(0.1)
        if frame is not None:
            frames.append(frame)
    return frames


def receive_all(host):
    frames = []
    while (frame := host.recv(0.1)) is not None:
        frames.append(frame)
    return frames


FRAMES = [
    can.Message(arbitration_id=0x121, is_extended_id=False, data=bytes(range(8))),
    can.Message(arbitration_id=0x1ABCDEF0, is_extended_id=True, data=b"\xff"),
    can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b""),
    can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=4),
]


def test_frames_reach_the_host_as_they_were(port):
    with host_of(port) as host:
        port.send(FRAMES)
        for got, sent in zip(receive(host, 4), FRAMES, strict=True):
            assert got.equals(
                sent, timestamp_delta=None, check_channel=False, check_direction=False
            )
    assert port.dropped == 0


def test_frames_of_the_host_reach_the_adapter(port):
    with host_of(port) as host:
        for frame in FRAMES:
            host.send(frame)
        found = []
        until(lambda: found.extend(port.received()) or len(found) == 4)
    assert [frame.arbitration_id for frame in found] == [f.arbitration_id for f in FRAMES]
    assert [bytes(frame.data) for frame in found] == [bytes(f.data) for f in FRAMES]


def test_it_answers_like_an_adapter(port):
    with host_of(port) as host:
        assert host.get_version(1.0) == (10, 13)
        assert host.get_serial_number(1.0) == "CSEM"


def test_frames_before_the_channel_is_open_and_error_frames_are_dropped(port):
    port.send(FRAMES)
    assert port.dropped == 4
    with host_of(port) as host:
        port.send([can.Message(arbitration_id=0x40, is_error_frame=True)])
        port.send(FRAMES[:1])
        assert len(receive(host, 1)) == 1
    assert port.dropped == 5


def test_a_host_that_does_not_read_holds_nobody_up_and_leaves_nothing_to_the_next(port):
    with host_of(port):
        began_s = time.monotonic()
        for _ in range(2000):
            port.send(FRAMES)
        assert time.monotonic() - began_s < 5.0
        assert port.dropped > 0
    until(lambda: not port.channel_open)
    with host_of(port) as host:
        port.send(FRAMES[2:3])
        assert [frame.arbitration_id for frame in receive(host, 1)] == [0x7FF]


@pytest.mark.slow
def test_a_host_that_falls_behind_loses_whole_frames_and_no_line_is_cut(port):
    frames = [
        can.Message(arbitration_id=number % 0x7FF, is_extended_id=False, data=bytes(number % 9))
        for number in range(9000)
    ]
    with host_of(port) as host:
        got = []
        for start in range(0, len(frames), 3000):  # more than the terminal holds
            port.send(frames[start : start + 3000])
            got += receive_all(host)
        port.send(frames[:1])
        got += receive_all(host)
    assert 0 < port.dropped < len(frames)
    assert len(got) == len(frames) + 1 - port.dropped
    sent = {(frame.arbitration_id, bytes(frame.data)) for frame in frames}
    assert {(frame.arbitration_id, bytes(frame.data)) for frame in got} <= sent


def test_pulling_it_makes_the_hosts_reads_fail(port):
    host = host_of(port)
    port.close()
    with pytest.raises((can.CanError, OSError)):
        receive(host, 1)
    port.send(FRAMES)
    with pytest.raises((can.CanError, OSError)):
        host.shutdown()
    host.serialPortOrig.close()


def test_a_link_gives_it_a_name_that_outlives_a_restart(tmp_path):
    link = tmp_path / "adapter"
    link.symlink_to("/dev/pts/none")  # left behind by one that was killed
    for _ in range(2):
        port = SlcanPort(str(link))
        assert port.path == str(link)
        assert os.path.exists(link)  # noqa: PTH110 (follows the link)
        port.close()
        assert not link.is_symlink()


def test_a_port_takes_only_its_own_link_away(tmp_path):
    link = tmp_path / "adapter"
    earlier, later = SlcanPort(str(link)), SlcanPort(str(link))
    earlier.close()
    assert link.is_symlink()
    later.close()
    assert not link.is_symlink()


def test_a_link_that_cannot_be_made_is_refused(tmp_path):
    taken = tmp_path / "file"
    taken.touch()
    elsewhere = tmp_path / "link"
    elsewhere.symlink_to(taken)
    for link in (taken, elsewhere, tmp_path / "none" / "adapter"):
        with pytest.raises(SlcanPortError, match="no link to"):
            SlcanPort(str(link))
    assert taken.exists()
    assert elsewhere.is_symlink()


@given(lines=st.lists(st.binary(max_size=80), max_size=20))
@settings(
    max_examples=40,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_any_bytes_of_a_host_are_answered_or_refused(port, lines):
    for line in lines:
        port._reply(line)
    assert port._thread.is_alive()
