"""Calibration files: read, written, applied to the map they were made for, and reported."""

from datetime import UTC, datetime

import pytest
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from cablesense_msgs_py.messages import Level
from cablesense_online.can.calibration import (
    CalibratedSensor,
    Calibration,
    calibrated,
    calibration_status,
    load_calibration,
    write_calibration,
)
from cablesense_online.can.channel_map import ChannelMapError, signal_conversion


def sensor(cable, channel_map=PACKED, database=PACKED_DATABASE, **changed):
    channel = channel_map.channels[cable]
    unit, factor, offset = signal_conversion(database, channel)
    values = {
        "message": channel.message,
        "signal": channel.signal,
        "signal_unit": unit,
        "signal_factor": factor,
        "signal_offset": offset,
        "scale_n_per_unit": 1.25,
        "zero": -3.0,
    }
    return CalibratedSensor(**(values | changed))


def calibration(cables, uncalibrated=(), name=PACKED.name):
    return Calibration(
        map=name, made=datetime.now(UTC), uncalibrated=tuple(uncalibrated), cables=cables
    )


WHOLE = {cable: sensor(cable) for cable in PACKED.channels}
TWO = {cable: WHOLE[cable] for cable in ("cable_2", "cable_11")}
OTHERS = [cable for cable in PACKED.channels if cable not in TWO]


def test_every_cable_gets_its_scale_and_zero():
    found = calibrated(PACKED, PACKED_DATABASE, calibration(WHOLE), "c.yaml")
    assert found.cable_names == PACKED.cable_names
    assert {c.tension_n(5.0) for c in found.channels.values()} == {10.0}


def test_cables_named_as_uncalibrated_keep_the_maps():
    found = calibrated(PACKED, PACKED_DATABASE, calibration(TWO, OTHERS), "c.yaml")
    assert found.channels["cable_11"].zero == -3.0
    assert found.channels["cable_1"] == PACKED.channels["cable_1"]


@pytest.mark.parametrize(
    ("given", "remedy"),
    [
        (calibration(WHOLE, name="another"), "made for map another, not for twelve_channel"),
        (calibration(TWO, OTHERS[1:]), "leaves out cable_1;"),
        (calibration(WHOLE, ["cable_1"]), "names cable_1 twice"),
        (calibration(TWO, [*OTHERS, "cable_13"]), "has cable_13, which map"),
        (calibration(WHOLE | {"cable_1": WHOLE["cable_2"]}), "cable_1 was calibrated as"),
        (calibration(WHOLE | {"cable_1": sensor("cable_1", signal_unit="mV/V")}), "in 'mV/V'"),
        (calibration(WHOLE | {"cable_1": sensor("cable_1", signal_factor=7.0)}), "factor 7,"),
    ],
)
def test_what_was_not_made_for_this_map_is_refused(given, remedy):
    with pytest.raises(ChannelMapError, match=r"^c\.yaml: ") as refusal:
        calibrated(PACKED, PACKED_DATABASE, given, "c.yaml")
    assert remedy in str(refusal.value)


def test_another_map_takes_its_own():
    cables = {cable: sensor(cable, SINGLE, SINGLE_DATABASE) for cable in SINGLE.channels}
    given = calibration(cables, name=SINGLE.name)
    assert calibrated(SINGLE, SINGLE_DATABASE, given, "c").channels["cable_4"].zero == -3.0


@pytest.mark.parametrize("scale", [0.0, float("nan"), True, 1e12])
def test_a_scale_that_cannot_be_is_refused(scale):
    with pytest.raises(ValidationError):
        sensor("cable_1", scale_n_per_unit=scale)


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


def test_no_calibration_is_reported_without_alarm():
    assert calibration_status(None).level is Level.OK
    assert "channel map" in calibration_status(None).message


def test_a_whole_one_is_reported_with_its_values():
    status = calibration_status(calibration(WHOLE))
    assert status.level is Level.OK
    assert status.values["cable_3"] == "1.25 N per unit from zero -3"


def test_cables_without_are_a_warning():
    status = calibration_status(calibration(TWO, OTHERS))
    assert status.level is Level.WARN
    assert "cable_12" in status.message
