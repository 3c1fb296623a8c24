"""Channel maps as files: found by name or path, refused with the reason."""

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_online.can.channel_map import (
    MAX_MAP_BYTES,
    ChannelMapError,
    bundled_maps,
    find_channel_map,
    load_channel_map,
    parse_channel_map,
)
from cablesense_sim.arm import open_arm

BUNDLED = find_channel_map("twelve_channel_amplifier").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", bundled_maps())
def test_a_bundled_map_has_every_cable_of_the_arm_once(name):
    channel_map, dbc = load_channel_map(name)
    assert channel_map.name == name
    assert channel_map.cable_names == open_arm("cdsm").cable_names
    assert dbc.is_file()


def test_a_path_is_taken_and_its_dbc_sought_beside_it(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(BUNDLED, encoding="utf-8")
    _, dbc = load_channel_map(file)
    assert dbc == tmp_path / "twelve_channel_amplifier.dbc"


def test_an_unknown_name_lists_the_bundled_ones():
    with pytest.raises(ChannelMapError, match="cia404_amplifier, twelve_channel_amplifier"):
        load_channel_map("none")


def test_a_missing_file_a_folder_and_a_huge_one_are_refused(tmp_path):
    with pytest.raises(ChannelMapError, match="no channel map file"):
        load_channel_map(tmp_path / "none.yaml")
    folder = tmp_path / "folder.yaml"
    folder.mkdir()
    with pytest.raises(ChannelMapError, match="no channel map file"):
        load_channel_map(folder)
    huge = tmp_path / "huge.yaml"
    huge.write_text("#" * (MAX_MAP_BYTES + 1))
    with pytest.raises(ChannelMapError, match="larger than"):
        load_channel_map(huge)


@pytest.mark.parametrize(
    ("text", "said"),
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
def test_a_broken_map_says_what_is_wrong_and_where(text, said):
    with pytest.raises(ChannelMapError, match=said) as caught:
        parse_channel_map(text, source="mine.yaml")
    assert str(caught.value).startswith("mine.yaml: ")
    assert "\n" not in str(caught.value)


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=20),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
        max_leaves=20,
    ),
    st.sampled_from(sorted(yaml.safe_load(BUNDLED))),
)
@settings(max_examples=60, deadline=None)
def test_any_value_under_any_key_is_taken_or_refused_in_one_line(value, key):
    content = {**yaml.safe_load(BUNDLED), key: value}
    said = ""
    try:
        parse_channel_map(yaml.safe_dump(content, allow_unicode=True))
    except ChannelMapError as error:
        said = str(error)
    assert "\n" not in said
