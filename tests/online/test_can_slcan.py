"""The slcan protocol: lines, and the adapter's end on a pseudo-terminal."""

import os
import time

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cablesense_online.can.bus import CanInterface
from cablesense_online.can.slcan import SlcanPort, SlcanPortError, frame_line, line_frame


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
    frame = line_frame(line)
    assert (frame.arbitration_id, bytes(frame.data)) == (number, data)
    assert frame.is_extended_id == line.startswith(b"T")


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
