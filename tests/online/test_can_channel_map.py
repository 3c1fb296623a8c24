"""The channel map as a value: what it computes and what it refuses."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from cablesense_online.can.channel_map import Channel, ChannelMap, ChannelMapError

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
    ("key", "value", "said"),
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
def test_what_cannot_be_is_refused(key, value, said):
    with pytest.raises(ValidationError, match=said):
        ChannelMap.model_validate({**GIVEN, key: value})


def test_channels_are_put_in_an_arms_order():
    channel_map = ChannelMap.model_validate(GIVEN)
    arranged = channel_map.arranged(("cable_2", "cable_1"))
    assert arranged.cable_names == ("cable_2", "cable_1")
    assert arranged.channels == channel_map.channels


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("cable_1", "cable_2", "cable_3"), "lacks cable_3; the cables of this arm are"),
        (("cable_1",), "has cable_2, which the arm has not"),
    ],
)
def test_a_map_for_other_cables_is_refused(names, said):
    with pytest.raises(ChannelMapError, match=said):
        ChannelMap.model_validate(GIVEN).arranged(names)
