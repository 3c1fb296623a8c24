"""Effects drawn at random: names checked, sizes as typical, places all of those there are."""

from __future__ import annotations

import numpy as np
import pytest

from cablesense_sim.effects.registry import known_effects
from cablesense_training.data.protocols import drawn_entries, effect_names
from cablesense_training.errors import DatasetError


def test_names_are_known_each_once_and_all_means_all() -> None:
    assert effect_names("sensor_gain, payload,payload") == ["payload", "sensor_gain"]
    assert {*known_effects()} - {*effect_names("all")} == {"load_cell"}


@pytest.mark.parametrize(
    "randomise", ["", "rust", "payload,", "payload;sensor_gain", "all,payload", "load_cell"]
)
def test_what_is_no_effect_is_refused_with_those_there_are(randomise: str) -> None:
    with pytest.raises(DatasetError, match=r"is no effect; give all, or names from .*payload"):
        effect_names(randomise)


def many(name: str, draws: int = 400) -> list:
    rng = np.random.default_rng(1)
    return [entry for _ in range(draws) for entry in drawn_entries([name], 4, 12, rng)]


@pytest.mark.parametrize("name", list(known_effects()))
def test_every_number_is_in_its_range_and_sizes_are_typical(name: str) -> None:
    effect = known_effects()[name]
    drawn = many(name)
    for parameter in effect.parameters:
        values = np.array([entry.values[parameter.name] for entry in drawn])
        assert (values >= parameter.low).all()
        assert (values <= parameter.high).all()
        if parameter.role == "size":
            assert np.sqrt((values**2).mean()) == pytest.approx(parameter.typical, rel=0.25)
            assert (values < 0.0).any() == (parameter.low < 0.0)


def test_a_finding_is_at_one_place_of_all_and_a_tolerance_everywhere() -> None:
    rng = np.random.default_rng(2)
    assert [e.place for e in drawn_entries(["segment_tolerance"], 4, 12, rng)] == [
        f"segment_{n}" for n in range(1, 5)
    ]
    assert {entry.place for entry in many("payload")} == {f"segment_{n}" for n in range(1, 5)}
    assert len(drawn_entries(["payload", "sensor_gain"], 4, 12, rng)) == 2
