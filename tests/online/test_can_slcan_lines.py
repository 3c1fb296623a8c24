"""Frames as slcan lines and back."""

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.can.slcan import frame_line, line_frame


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
