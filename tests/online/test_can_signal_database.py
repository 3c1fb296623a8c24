"""DBC files, and whether a channel map fits one."""

import pytest
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_base.installation import config_path
from cablesense_online.can.channel_map import (
    ChannelMapError,
    bundled_maps,
    check_fit,
    open_channel_map,
    parse_database,
)

TEXT = config_path("can/twelve_channel_amplifier.dbc").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", bundled_maps())
def test_a_bundled_dbc_fits_its_map_and_says_that_no_hardware_has_seen_it(name):
    channel_map, _ = open_channel_map(name)
    text = " ".join(config_path(f"can/{channel_map.dbc}").read_text(encoding="utf-8").split())
    assert "written from published manuals" in text.lower()
    assert "not been tried on hardware" in text


def bits(message):
    """Longest form of a standard frame with the space after it, worst bit stuffing."""
    return 8 * message.length + 44 + (34 + 8 * message.length - 1) // 4 + 3


def test_the_bus_bears_the_rates_that_the_maps_say():
    packed = sum(bits(message) for message in PACKED_DATABASE.messages)
    nodes = [m for m in SINGLE_DATABASE.messages if m.name.startswith("TPDO_")]
    single = sum(bits(message) for message in nodes)
    assert packed == 470
    assert packed / PACKED.cycle_time_s < 1e6
    assert single == 1260
    assert single / SINGLE.cycle_time_s < 1e6 < single / 0.001


def test_the_amplifiers_have_the_documented_layout():
    tension = PACKED_DATABASE.get_message_by_name("TENSIONS_5_TO_8").get_signal_by_name(
        "TENSION_6"
    )
    assert (tension.start, tension.length, tension.is_signed) == (16, 16, True)
    node = SINGLE_DATABASE.get_message_by_name("TPDO_12")
    assert (node.frame_id, node.length) == (0x18C, 5)
    assert [signal.length for signal in node.signals] == [32, 8]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no messages|not a DBC"),
        ("hello", "not a DBC"),
        (TEXT.replace("0|16@1-", "60|16@1-", 1), "leave its message"),
        (TEXT.replace("16|16@1-", "8|16@1-", 1), "over another"),
    ],
)
def test_a_broken_dbc_is_refused(text, said):
    with pytest.raises(ChannelMapError, match=said) as caught:
        parse_database(text, source="mine.dbc")
    assert str(caught.value).startswith("mine.dbc: ")


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_a_mutated_dbc_is_read_or_refused(data):
    at = data.draw(st.integers(0, len(TEXT) - 1))
    cut = data.draw(st.integers(0, 40))
    text = TEXT[:at] + data.draw(st.text(max_size=10)) + TEXT[at + cut :]
    said = ""
    try:
        check_fit(PACKED, parse_database(text))
    except ChannelMapError as error:
        said = str(error)
    assert "\n" not in said


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("TENSIONS_5_TO_8:", "OTHERS:", "channel cable_5: no message TENSIONS_5_TO_8; there are"),
        (" TENSION_7 ", " OTHER ", "channel cable_7: no signal TENSION_7 in message"),
        ("CYCLE_COUNTER : 0|8@1+", "CYCLE_COUNTER : 0|8@1-", "counter: CYCLE_COUNTER must be"),
    ],
)
def test_a_dbc_that_does_not_fit_says_for_which_cable(old, new, said):
    with pytest.raises(ChannelMapError, match=said):
        check_fit(PACKED, parse_database(TEXT.replace(old, new)))


def test_a_multiplexed_message_is_refused():
    text = TEXT.replace("TENSION_1 :", "TENSION_1 M :").replace("TENSION_2 :", "TENSION_2 m0 :")
    with pytest.raises(ChannelMapError, match="multiplexed"):
        check_fit(PACKED, parse_database(text))


@pytest.mark.parametrize("factor", ["1e999", "9" * 400, "1e31"])
def test_a_factor_that_no_sensor_has_is_refused(factor):
    text = TEXT.replace("(0.1,0)", f"({factor},0)")
    with pytest.raises(ChannelMapError, match=r"cable_1: factor or offset of TENSION_1"):
        check_fit(PACKED, parse_database(text))


@pytest.mark.parametrize("id_", [288, 500])
def test_two_messages_of_one_name_or_id_are_refused(id_):
    name = "CYCLE" if id_ == 500 else "CYCLE_AGAIN"
    more = f'BO_ {id_} {name}: 1 AMPLIFIER\n SG_ OTHER : 0|8@1+ (1,0) [0|255] "" DRIVER\n'
    with pytest.raises(ChannelMapError, match="the same name or the same id"):
        check_fit(PACKED, parse_database(TEXT.replace("BO_ 289 ", f"{more}\nBO_ 289 ", 1)))


def test_a_status_or_counter_without_measure_is_refused():
    text = config_path("can/cia404_amplifier.dbc").read_text(encoding="utf-8")
    text = text.replace("STATUS_1 : 32|8@1+ (1,0)", "STATUS_1 : 32|8@1+ (1e999,0)", 1)
    with pytest.raises(ChannelMapError, match="factor or offset of STATUS_1"):
        check_fit(SINGLE, parse_database(text))
    with pytest.raises(ChannelMapError, match="factor or offset of CYCLE_COUNTER"):
        check_fit(PACKED, parse_database(TEXT.replace("0|8@1+ (1,0)", "0|8@1+ (1,1e31)", 1)))
