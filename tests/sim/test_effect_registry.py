"""The catalogue: what every effect declares, and entries in arm files, valid or refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from arm_variants import variant

from cablesense_sim.arm import ArmFileError, open_arm, parse_arm
from cablesense_sim.build import entries_of
from cablesense_sim.effects.effect import Effect
from cablesense_sim.effects.registry import known_effects


def effects() -> list[Effect]:
    return list(known_effects().values())


@pytest.mark.parametrize("effect", effects(), ids=lambda e: e.name)
def test_an_effect_says_what_it_is(effect: Effect) -> None:
    assert effect.about
    assert not effect.about.endswith(".")
    assert effect.tolerance or effect.advice.endswith(".")
    assert effect.source
    assert effect.acts_on in ("load", "arm", "transmission", "actuator", "sensor")
    assert effect.parameters[0].role == "size"
    assert len(set(effect.places(4, 12))) == len(effect.places(4, 12)) > 0
    names = [p.name for p in effect.parameters]
    assert len(set(names)) == len(names)
    for parameter in effect.parameters:
        assert parameter.unit
        assert parameter.about
        assert parameter.low < parameter.high
        assert parameter.low <= parameter.default <= parameter.high
        assert 0.0 < parameter.typical <= max(parameter.high, -parameter.low)
        assert all(parameter.low <= s <= parameter.high for s in parameter.starts)
        if parameter.role == "size":
            assert parameter.default == 0.0


@pytest.mark.parametrize("effect", effects(), ids=lambda e: e.name)
def test_where_an_effect_acts_is_where_it_says(effect: Effect) -> None:
    place = effect.places(4, 12)[0]
    values = {p.name: np.array([p.default]) for p in effect.parameters}
    acting = {
        "load": effect.loading(place, values),
        "actuator": effect.actuation(place, values),
        "transmission": effect.transmission(place, values),
        "sensor": effect.sensing(place, values),
    }
    if effect.tolerance:
        return
    assert [where for where, what in acting.items() if what is not None] == (
        [] if effect.acts_on == "arm" else [effect.acts_on]
    )


GAIN = {"effect": "sensor_gain", "at": "cable_3", "parameters": {"gain": 0.04}}
CREEP = {"effect": "cable_creep", "parameters": {"share": 0.2}}


def with_effects(*listed: Any) -> Any:
    return variant({"effects": list(listed)}, "cdsm_lab")


def test_what_is_not_given_has_its_default_and_order_is_kept() -> None:
    gain, creep = entries_of(with_effects(GAIN, CREEP))
    assert (gain.effect.name, gain.place, gain.values) == (
        "sensor_gain",
        "cable_3",
        {"gain": 0.04},
    )
    assert creep.place == "arm"
    assert creep.values == {
        p.name: 0.2 if p.name == "share" else p.default for p in creep.effect.parameters
    }


def test_effects_are_part_of_who_the_arm_is_and_survive_a_file() -> None:
    import yaml

    arm = with_effects(GAIN, CREEP)
    assert arm.identity != open_arm("cdsm_lab").identity
    again = parse_arm(yaml.safe_dump(arm.model_dump()))
    assert again == arm
    assert again.identity == arm.identity


@pytest.mark.parametrize(
    ("listed", "words"),
    [
        ({"effect": "rust"}, "'rust' is unknown; known: actuator_backlash, .*sensor_lag"),
        (GAIN | {"at": "cable_13"}, "cannot be at 'cable_13'; valid: cable_1, .*…"),
        (GAIN | {"at": "arm"}, "cannot be at 'arm'"),
        ({"effect": "sensor_gain"}, "cannot be at 'arm'"),
        (CREEP | {"at": "segment_5"}, "cannot be at 'segment_5'; valid: arm, segment_1"),
        (GAIN | {"parameters": {"gian": 0.1}}, "no parameter 'gian'; it has gain"),
        (GAIN | {"parameters": {"gain": 0.6}}, "gain = 0.6 1 must be from -0.5 to 0.5"),
        (CREEP | {"parameters": {"time_s": 0.0}}, "time_s = 0 s must be from 0.5 to 3000"),
        (GAIN | {"parameters": {"gain": True}}, "= True: must be a number"),
        (GAIN | {"parameters": {"gain": math.nan}}, "finite"),
        (GAIN | {"parameters": {"gain": math.inf}}, "finite"),
        (GAIN | {"parameters": {"gain": "much"}}, "number"),
        (GAIN | {"parameters": [0.1]}, "parameters"),
        (GAIN | {"size": 3}, "size"),
        ("sensor_gain", "effects"),
        ({"at": "cable_3"}, "effect"),
    ],
)
def test_an_entry_that_cannot_be_is_refused_in_one_line(listed: Any, words: str) -> None:
    with pytest.raises(ArmFileError, match=words) as caught:
        with_effects(listed)
    assert "\n" not in str(caught.value)
