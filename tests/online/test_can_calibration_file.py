"""Calibrations as files: written and read back, refused with the reason."""

from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_can_calibration import OTHERS, TWO, calibration

from cablesense_online.can.calibration import load_calibration, write_calibration
from cablesense_online.can.channel_map import ChannelMapError


def test_what_is_written_is_read(tmp_path):
    made = calibration(TWO, OTHERS).model_copy(
        update={"made": datetime(2026, 3, 1, 12, tzinfo=UTC)}
    )
    path = tmp_path / "calibration.yaml"
    write_calibration(path, made)
    assert load_calibration(path) == made
    assert "-p calibration" in path.read_text(encoding="utf-8")
    assert list(tmp_path.iterdir()) == [path]


@given(scale=st.floats(1e-9, 1e9), zero=st.floats(-1e12, 1e12))
def test_numbers_come_back_to_the_last_bit(tmp_path_factory, scale, zero):
    sensor = TWO["cable_2"].model_copy(update={"scale_n_per_unit": scale, "zero": zero})
    path = tmp_path_factory.mktemp("numbers") / "c.yaml"
    write_calibration(path, calibration({"cable_2": sensor}))
    read = load_calibration(path).cables["cable_2"]
    assert (read.scale_n_per_unit, read.zero) == (scale, zero)


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("[1, 2]", "holds list, not a mapping"),
        ("map: &a x\nmade: *a\n", "alias"),
        ("map: m\nmap: n\n", "stands twice"),
        ("map: m\nmade: 2026-01-01\ncables: {}\n", "cables"),
        ("map: m\nmade: soon\ncables: {c: {}}\n", "made"),
    ],
)
def test_a_broken_file_is_refused_by_name(tmp_path, text, remedy):
    path = tmp_path / "c.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ChannelMapError, match=r"c\.yaml: ") as refusal:
        load_calibration(path)
    assert remedy in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_place_that_cannot_be_written_to_is_named(tmp_path):
    with pytest.raises(ChannelMapError, match="cannot be written"):
        write_calibration(tmp_path / "none" / "c.yaml", calibration(TWO, OTHERS))
