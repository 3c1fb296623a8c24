"""Channel maps and their DBC files: what fits is read, anything else is refused in one line."""

import pytest
import yaml
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from cablesense_base.installation import config_path
from cablesense_base.plain_yaml import read_plain
from cablesense_online.can.channel_map import (
    MAX_MAP_BYTES,
    Channel,
    ChannelMap,
    ChannelMapError,
    check_fit,
    open_channel_map,
    parse_database,
)
from cablesense_sim.arm import open_arm

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


def test_channels_keep_the_order_of_the_map():
    turned = {**GIVEN, "channels": dict(reversed(GIVEN["channels"].items()))}
    assert ChannelMap.model_validate(turned).cable_names == ("cable_2", "cable_1")


@given(
    st.floats(-1e4, 1e4),
    st.one_of(st.floats(1e-3, 1e3), st.floats(-1e3, -1e-3)),
    st.floats(-1e6, 1e6),
)
def test_value_and_tension_are_inverse(tension_n, scale, zero):
    channel = Channel(message="A", signal="S", scale_n_per_unit=scale, zero=zero)
    back = channel.tension_n(channel.value(tension_n))
    assert back == pytest.approx(tension_n, rel=1e-6, abs=1e-9 * max(1.0, abs(zero * scale)))


@pytest.mark.parametrize(
    ("key", "value", "refusal"),
    [
        ("dbc", "../secret.dbc", "beside the map"),
        ("dbc", "amplifier.txt", "beside the map"),
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


def test_channels_are_put_in_an_arms_order():
    channel_map = ChannelMap.model_validate(GIVEN)
    arranged = channel_map.arranged(("cable_2", "cable_1"))
    assert arranged.cable_names == ("cable_2", "cable_1")
    assert arranged.channels == channel_map.channels


@pytest.mark.parametrize(
    ("names", "refusal"),
    [
        (("cable_1", "cable_2", "cable_3"), "lacks cable_3; the cables of this arm are"),
        (("cable_1",), "has cable_2, which the arm has not"),
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


def test_an_unknown_name_lists_the_bundled_ones():
    with pytest.raises(ChannelMapError, match="cia404_amplifier, twelve_channel_amplifier"):
        open_channel_map("none")


def test_a_missing_file_a_folder_and_a_huge_one_are_refused(tmp_path):
    with pytest.raises(ChannelMapError, match="no channel map file"):
        open_channel_map(tmp_path / "none.yaml")
    folder = tmp_path / "folder.yaml"
    folder.mkdir()
    with pytest.raises(ChannelMapError, match="no channel map file"):
        open_channel_map(folder)
    huge = tmp_path / "huge.yaml"
    huge.write_text("#" * (MAX_MAP_BYTES + 1))
    with pytest.raises(ChannelMapError, match="larger than"):
        open_channel_map(huge)


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        ("- 1", "holds list, not a mapping"),
        ("name: [", "not plain YAML"),
        ("name: a\nname: b", "'name' stands twice"),
        ("name: &a x\ndbc: *a", "write the value out"),
        ("name: !!python/object/apply:os.getcwd []", "a tag"),
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


@pytest.mark.slow
@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=20),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
        max_leaves=20,
    ),
    st.sampled_from(sorted(yaml.safe_load(BUNDLED))),
)
@settings(max_examples=30, deadline=None)
def test_any_value_under_any_key_is_taken_or_refused_in_one_line(value, key):
    content = {**yaml.safe_load(BUNDLED), key: value}
    refusal = ""
    try:
        text = yaml.safe_dump(content, allow_unicode=True)
        read_plain(text, "mine.yaml", ChannelMap, ChannelMapError)
    except ChannelMapError as error:
        refusal = str(error)
    assert "\n" not in refusal


HEAD = 'VERSION ""\n'
SIGNAL = 'BO_ 1 A: 8 X\n SG_ s : 0|8@1+ (1,0) [0|4000000000] "" X\n'


def test_what_a_bus_carries_is_let_through():
    for text in (HEAD + SIGNAL, HEAD + SIGNAL.replace("A: 8", "A: 1785")):
        assert parse_database(text, "f").messages[0].name == "A"
    assert parse_database(HEAD + "// A: 999999999 X\n" + SIGNAL + 'CM_ "A: 999999999 X";\n')


@pytest.mark.parametrize(
    ("was", "becomes", "refusal"),
    [
        ("A: 8", "A: 1786", "line 2: a message of bytes 1786; it must be at most 1785"),
        ("A: 8", "A //:\n : //x\n 1000000000 ", "line 4: a message of bytes"),
        ("A: 8", "A: " + "9" * 5000, "a message of bytes 9"),
        ("0|8@", "1000000000|8@", "line 3: a signal from bit"),
        ("0|8@", "0|1000000000@", "line 3: a signal of bits"),
        ("0|8@", "0| // 8@\n1000000000 @", "a signal of bits"),
    ],
)
def test_one_line_cannot_ask_for_all_memory(was, becomes, refusal):
    with pytest.raises(ChannelMapError, match=refusal) as caught:
        parse_database(HEAD + SIGNAL.replace(was, becomes), "f.dbc")
    assert len(str(caught.value)) < 200


@pytest.mark.slow
@pytest.mark.parametrize("text", ['"', '"' * 400_001, "//:\n:" * 200_000, '\\"' * 400_000, ":|"])
def test_any_text_is_looked_through_at_once(text):
    with pytest.raises(ChannelMapError):
        parse_database(text, "f")


TEXT = config_path("can/twelve_channel_amplifier.dbc").read_text(encoding="utf-8")


@pytest.mark.parametrize("channel_map", [PACKED, SINGLE], ids=lambda made: made.name)
def test_a_bundled_dbc_states_that_it_was_not_tried_on_hardware(channel_map):
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
    ("text", "refusal"),
    [
        ("", "no messages|not a DBC"),
        ("hello", "not a DBC"),
        (TEXT.replace("0|16@1-", "60|16@1-", 1), "leave its message"),
        (TEXT.replace("16|16@1-", "8|16@1-", 1), "over another"),
    ],
)
def test_a_broken_dbc_is_refused(text, refusal):
    with pytest.raises(ChannelMapError, match=refusal) as caught:
        parse_database(text, source="mine.dbc")
    assert str(caught.value).startswith("mine.dbc: ")


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_a_mutated_dbc_is_read_or_refused(data):
    at = data.draw(st.integers(0, len(TEXT) - 1))
    cut = data.draw(st.integers(0, 40))
    text = TEXT[:at] + data.draw(st.text(max_size=10)) + TEXT[at + cut :]
    refusal = ""
    try:
        check_fit(PACKED, parse_database(text))
    except ChannelMapError as error:
        refusal = str(error)
    assert "\n" not in refusal


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
