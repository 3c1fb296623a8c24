"""A calibration in place of a map's scales and zeros, and which map it is refused for."""

from datetime import UTC, datetime

import pytest
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE
from pydantic import ValidationError

from cablesense_online.can.calibration import CalibratedSensor, Calibration, calibrated
from cablesense_online.can.channel_map import ChannelMapError, channel_signal


def sensor(cable, channel_map=PACKED, database=PACKED_DATABASE, **changed):
    channel = channel_map.channels[cable]
    signal = channel_signal(database, channel)
    values = {
        "message": channel.message,
        "signal": channel.signal,
        "signal_unit": signal.unit,
        "signal_factor": signal.factor,
        "signal_offset": signal.offset,
        "scale_n_per_unit": 1.25,
        "zero": -3.0,
    }
    return CalibratedSensor(**(values | changed))


def calibration(cables, uncalibrated=(), name=PACKED.name):
    return Calibration(
        map=name, made=datetime.now(UTC), uncalibrated=list(uncalibrated), cables=cables
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
