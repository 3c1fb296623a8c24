"""Channel maps, DBC files and calibrations: a fitting one is read, others are refused."""

from datetime import UTC, datetime

import pytest
from pydantic import ValidationError

from cablesense_base.installation import config_path
from cablesense_base.plain_yaml import read_plain
from cablesense_online.can.channel_map import (
    ChannelMap,
    ChannelMapError,
    ScaledSensor,
    SensorScales,
    check_fit,
    load_sensor_scales,
    open_channel_map,
    parse_database,
    signal_conversion,
    with_sensor_scales,
    write_sensor_scales,
)
from cablesense_sim.arm import open_arm
from tests.helpers.can_frames import PACKED, PACKED_DATABASE, SINGLE

GIVEN = {
    "name": "amplifier",
    "dbc": "amplifier.dbc",
    "cycle_time_s": 0.001,
    "skew_limit_s": 0.0005,
    "flood_frames_s": 1000.0,
    "range_n": [-10.0, 1000.0],
    "stuck": {"after_s": 1.0, "others_moved_n": 5.0},
    "channels": {
        "cable_1": {"message": "A", "signal": "S1"},
        "cable_2": {"message": "A", "signal": "S2"},
    },
}


@pytest.mark.parametrize(
    ("key", "value", "refusal"),
    [
        ("skew_limit_s", 0.002, "at most cycle_time_s"),
        ("range_n", [5.0, 5.0], "lowest, highest"),
        ("channels", {}, "at least 1"),
        ("nmt_start_nodes", [0], "greater than or equal to 1"),
        ("cycle_time_s", True, "must be a number"),
        ("cycle_time_s", float("nan"), "finite"),
        (
            "channels",
            {"cable_1": {"message": "A", "signal": "S", "scale_n_per_unit": 0.0}},
            "newtons",
        ),
        (
            "channels",
            {c: {"message": "A", "signal": "S"} for c in ("cable_1", "cable_2")},
            "cable_1 and cable_2 the same signal A.S",
        ),
    ],
)
def test_what_cannot_be_is_refused(key, value, refusal):
    with pytest.raises(ValidationError, match=refusal):
        ChannelMap.model_validate({**GIVEN, key: value})


@pytest.mark.parametrize(
    ("names", "refusal"),
    [
        (("cable_1", "cable_2", "cable_3"), "lacks cable_3 and has none"),
        (("cable_1",), "lacks no cable and has cable_2 that"),
    ],
)
def test_a_map_for_other_cables_is_refused(names, refusal):
    with pytest.raises(ChannelMapError, match=refusal):
        ChannelMap.model_validate(GIVEN).arranged(names)


BUNDLED = config_path("can/twelve_channel_amplifier.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize("channel_map", [PACKED, SINGLE], ids=lambda made: made.name)
def test_a_bundled_map_has_every_cable_of_the_arm_once(channel_map):
    assert channel_map.cable_names == open_arm("cdsm").cable_names


def test_a_path_is_taken_and_its_dbc_sought_beside_it(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(BUNDLED, encoding="utf-8")
    with pytest.raises(ChannelMapError, match=f"{tmp_path}/twelve_channel_amplifier.dbc: "):
        open_channel_map(file)
    (tmp_path / "twelve_channel_amplifier.dbc").write_text(TEXT, encoding="utf-8")
    assert open_channel_map(file)[0] == PACKED
    of_windows = TEXT.replace('"N"', '"µm"', 1)
    assert of_windows != TEXT
    (tmp_path / "twelve_channel_amplifier.dbc").write_text(of_windows, encoding="cp1252")
    _, database = open_channel_map(file)
    units = {signal.unit for message in database.messages for signal in message.signals}
    assert "µm" in units


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        ("- 1", "holds list, not a mapping"),
        ("name: [", "not plain YAML"),
        ("name: a\nname: b", "'name' stands twice"),
        ("name: &a x\ndbc: *a", "write the value out"),
        ("name: !!python/object/apply:os.getcwd []", "tag"),
        (BUNDLED.replace("cycle_time_s", "cycle_time"), "cycle_time"),
        (BUNDLED.replace("cycle_time_s: 0.001", "cycle_time_s: 10"), "must be at most 1"),
        (BUNDLED.replace("signal: TENSION_3,", ""), "channels.cable_3.signal is missing"),
    ],
)
def test_a_broken_map_is_refused_with_what_is_wrong_and_where(text, refusal):
    with pytest.raises(ChannelMapError, match=refusal) as caught:
        read_plain(text, "mine.yaml", ChannelMap, ChannelMapError)
    assert str(caught.value).startswith("mine.yaml: ")
    assert "\n" not in str(caught.value)


HEAD = 'VERSION ""\n'
SIGNAL = 'BO_ 1 A: 8 X\n SG_ s : 0|8@1+ (1,0) [0|4000000000] "" X\n'


@pytest.mark.parametrize(
    ("was", "becomes"),
    [("A: 8", "A: " + "9" * 5000), ("0|8@", "1000000000|8@"), ("0|8@", "0|1000000000@")],
)
def test_one_line_cannot_ask_for_all_memory(was, becomes):
    assert parse_database(HEAD + SIGNAL, "f.dbc").messages[0].name == "A"
    with pytest.raises(ChannelMapError, match="larger than any message") as caught:
        parse_database(HEAD + SIGNAL.replace(was, becomes), "f.dbc")
    assert len(str(caught.value)) < 200


TEXT = config_path("can/twelve_channel_amplifier.dbc").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        ("", "not a valid DBC"),
        ("hello", "not a valid DBC"),
        (TEXT.replace("0|16@1-", "60|16@1-", 1), "exceed its message"),
        (TEXT.replace("16|16@1-", "8|16@1-", 1), "overlap another"),
    ],
)
def test_a_broken_dbc_is_refused(text, refusal):
    with pytest.raises(ChannelMapError, match=refusal) as caught:
        parse_database(text, source="mine.dbc")
    assert str(caught.value).startswith("mine.dbc: ")


def test_a_big_endian_signal_that_does_not_fit_is_told_where_it_starts():
    """From bit 56 on it goes down to the end of byte 7, and beyond; from bit 55 on it fits."""
    big_endian = HEAD + SIGNAL.replace("0|8@1+", "55|16@0+")
    assert parse_database(big_endian).messages[0].signals[0].byte_order == "big_endian"
    with pytest.raises(ChannelMapError, match="15 in byte 1"):
        parse_database(big_endian.replace("55|16", "56|16"))
    with pytest.raises(ChannelMapError) as caught:
        parse_database(HEAD + SIGNAL.replace("0|8@1+", "60|8@1+"))
    assert "endian" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "refusal"),
    [
        ("TENSIONS_5_TO_8:", "OTHERS:", "channel cable_5: no message TENSIONS_5_TO_8; there are"),
        (" TENSION_7 ", " OTHER ", "channel cable_7: no signal TENSION_7 in message"),
        ("CYCLE_COUNTER : 0|8@1+", "CYCLE_COUNTER : 0|8@1-", "counter: CYCLE_COUNTER must be"),
    ],
)
def test_a_dbc_that_does_not_fit_is_refused_for_its_cable(old, new, refusal):
    with pytest.raises(ChannelMapError, match=refusal):
        check_fit(PACKED, parse_database(TEXT.replace(old, new)))


def test_a_message_whose_signals_take_turns_is_refused_in_one_line():
    text = """VERSION ""
BO_ 1 A: 8 X
 SG_ PAGE M : 0|8@1+ (1,0) [0|0] "" X
 SG_ S1 m0 : 8|16@1- (1,0) [0|0] "N" X
 SG_ S2 m1 : 8|16@1- (1,0) [0|0] "N" X
"""
    with pytest.raises(ChannelMapError, match="channel cable_1: message A is multiplexed") as told:
        check_fit(ChannelMap.model_validate(GIVEN), parse_database(text), "mine.dbc")
    assert str(told.value).startswith("mine.dbc: ")
    assert "it must be a plain message" in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("unit", "remedy"),
    [
        ("kgf", "state its scale_n_per_unit: 9.80665, the newtons of one such unit"),
        ("lbf", "state its scale_n_per_unit: 4.448222, the"),
        ("mN", "state its scale_n_per_unit: 0.001, the"),
        ("kN", "state its scale_n_per_unit: 1000, the"),
        ("mV/V", "state its scale_n_per_unit, the newtons of one such unit"),
    ],
)
def test_a_signal_in_another_unit_than_newtons_needs_a_scale(unit, remedy):
    given = PACKED.model_dump()
    database = parse_database(TEXT.replace('3276.7] "N"', f'3276.7] "{unit}"'))
    check_fit(PACKED, database)  # the bundled map states all its scales
    del given["channels"]["cable_5"]["scale_n_per_unit"]
    with pytest.raises(ChannelMapError) as refused:
        check_fit(ChannelMap.model_validate(given), database)
    line = str(refused.value)
    assert f"channel cable_5: TENSION_5 is in '{unit}', not in N" in line
    assert remedy in line
    assert "\n" not in line
    for newtons in ("N", ""):
        in_newtons = TEXT.replace('3276.7] "N"', f'3276.7] "{newtons}"')
        check_fit(ChannelMap.model_validate(given), parse_database(in_newtons))


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
    return ScaledSensor(**(values | changed))


def calibration(cables, uncalibrated=(), name=PACKED.name):
    return SensorScales(
        map=name, made=datetime.now(UTC), uncalibrated=tuple(uncalibrated), cables=cables
    )


WHOLE = {cable: sensor(cable) for cable in PACKED.channels}
TWO = {cable: WHOLE[cable] for cable in ("cable_2", "cable_11")}
OTHERS = [cable for cable in PACKED.channels if cable not in TWO]


def test_cables_get_their_scale_and_zero_and_uncalibrated_ones_keep_the_maps():
    scaled_map = with_sensor_scales(PACKED, PACKED_DATABASE, calibration(WHOLE), "c.yaml")
    assert scaled_map.cable_names == PACKED.cable_names
    assert {c.tension_n(5.0) for c in scaled_map.channels.values()} == {10.0}
    scaled_map = with_sensor_scales(PACKED, PACKED_DATABASE, calibration(TWO, OTHERS), "c.yaml")
    assert scaled_map.channels["cable_11"].zero == -3.0
    assert scaled_map.channels["cable_1"] == PACKED.channels["cable_1"]


@pytest.mark.parametrize(
    ("given", "remedy"),
    [
        (calibration(WHOLE, name="another"), "made for map another, not for twelve_channel"),
        (calibration(TWO, OTHERS[1:]), "cable_1: every cable"),
        (calibration(WHOLE, ["cable_1"]), "cable_1: every cable"),
        (calibration(TWO, [*OTHERS, "cable_13"]), "cable_13: every cable"),
        (calibration(WHOLE | {"cable_1": WHOLE["cable_2"]}), "cable_1 was calibrated as"),
        (calibration(WHOLE | {"cable_1": sensor("cable_1", signal_unit="mV/V")}), "in 'mV/V'"),
        (calibration(WHOLE | {"cable_1": sensor("cable_1", signal_factor=7.0)}), "factor 7,"),
    ],
)
def test_what_was_not_made_for_this_map_is_refused(given, remedy):
    with pytest.raises(ChannelMapError, match=r"^c\.yaml: ") as refusal:
        with_sensor_scales(PACKED, PACKED_DATABASE, given, "c.yaml")
    assert remedy in str(refusal.value)


def test_what_is_written_is_read(tmp_path):
    made = calibration(TWO, OTHERS).model_copy(
        update={"made": datetime(2026, 3, 1, 12, tzinfo=UTC)}
    )
    path = tmp_path / "calibration.yaml"
    write_sensor_scales(path, made)
    assert load_sensor_scales(path) == made
    assert "-p sensor_calibration_file" in path.read_text(encoding="utf-8")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("[1, 2]", "holds list, not a mapping"),
        ("map: m\nmade: 2026-01-01\ncables: {}\n", "cables"),
        ("map: m\nmade: soon\ncables: {c: {}}\n", "made"),
    ],
)
def test_a_broken_calibration_is_refused_by_name(tmp_path, text, remedy):
    path = tmp_path / "c.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ChannelMapError, match=r"c\.yaml: ") as refusal:
        load_sensor_scales(path)
    assert remedy in str(refusal.value)
    assert "\n" not in str(refusal.value)
