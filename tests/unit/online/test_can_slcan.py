"""The adapter's end of slcan: lines as the protocol has them, and python-can as the host."""

import os
import time

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.can.bus import CanInterface
from cablesense_online.can.emulator import SlcanPort, SlcanPortError, frame_line, line_frame
from tests.helpers.waiting import until

FRAMES = [
    can.Message(arbitration_id=0x121, is_extended_id=False, data=bytes(range(8))),
    can.Message(arbitration_id=0x1ABCDEF0, is_extended_id=True, data=b"\xff"),
    can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b""),
    can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=4),
]


def test_lines_are_those_of_the_protocol():
    assert frame_line(FRAMES[0]) == b"t12180001020304050607"
    assert frame_line(FRAMES[1]) == b"T1ABCDEF01FF"
    assert frame_line(FRAMES[3]) == b"r1234"
    assert frame_line(can.Message(is_error_frame=True)) is None
    assert frame_line(can.Message(is_fd=True, data=bytes(12))) is None


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


@pytest.mark.parametrize(
    "line",
    [b"", b"t123", b"t1239", b"t1232AA", b"t1231GG", b"tFFF0", b"TFFFFFFFF0", b"x1230", b"t1_30"],
)
def test_a_line_that_is_no_frame_is_refused(line):
    with pytest.raises(ValueError, match=r"."):
        line_frame(line)


@pytest.fixture
def port():
    port = SlcanPort()
    yield port
    port.shutdown()


def host_of(port):
    host = CanInterface("slcan", port.path, 1_000_000).open()
    until(lambda: port.recv(0.0) or port.channel_open)
    return host


def send(port, frames):
    """How many frames the port did not pass on."""
    dropped = 0
    for frame in frames:
        try:
            port.send(frame)
        except can.CanError:
            dropped += 1
    return dropped


def receive(host):
    frames = []
    while (frame := host.recv(0.1)) is not None:
        frames.append(frame)
    return frames


def test_frames_reach_the_host_as_they_were(port):
    with host_of(port) as host:
        assert send(port, FRAMES) == 0
        for got, sent in zip(receive(host), FRAMES, strict=True):
            assert got.equals(
                sent, timestamp_delta=None, check_channel=False, check_direction=False
            )


def test_frames_of_the_host_reach_the_adapter(port):
    with host_of(port) as host:
        for frame in FRAMES:
            host.send(frame)
        found = []
        until(lambda: found.append(port.recv(0.0)) or len(list(filter(None, found))) == 4)
    found = list(filter(None, found))
    assert [frame.arbitration_id for frame in found] == [f.arbitration_id for f in FRAMES]
    assert [bytes(frame.data) for frame in found] == [bytes(f.data) for f in FRAMES]


def test_a_host_that_falls_behind_loses_whole_frames_and_leaves_nothing_to_the_next(port):
    frames = [
        can.Message(arbitration_id=number, is_extended_id=False, data=bytes(number % 9))
        for number in range(2000)
    ]
    with host_of(port) as host:
        # more than the terminal holds
        began_s = time.monotonic()
        dropped = send(port, frames)
        assert time.monotonic() - began_s < 5.0
        got = receive(host)
        assert send(port, frames[:1]) == 0
        got += receive(host)
        send(port, frames)
    assert 0 < dropped < len(frames)
    assert len(got) == len(frames) + 1 - dropped
    sent = {(frame.arbitration_id, bytes(frame.data)) for frame in frames}
    assert {(frame.arbitration_id, bytes(frame.data)) for frame in got} <= sent
    until(lambda: port.recv(0.0) or not port.channel_open)
    with host_of(port) as host:
        assert send(port, FRAMES[2:3]) == 0
        assert [frame.arbitration_id for frame in receive(host)] == [0x7FF]


def test_a_link_gives_it_a_name_that_outlives_a_restart(tmp_path):
    link = tmp_path / "adapter"
    link.symlink_to("/dev/pts/none")  # left behind by one that was killed
    earlier = SlcanPort(str(link))
    assert earlier.path == str(link)
    assert os.path.exists(link)  # noqa: PTH110 (follows the link)
    later = SlcanPort(str(link))
    earlier.shutdown()
    assert link.is_symlink()  # a port takes only its own link away
    later.shutdown()
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
