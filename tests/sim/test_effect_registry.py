"""The catalogue: what every effect says of itself, and effects of other packages."""

from __future__ import annotations

import numpy as np
import pytest

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
    assert effect.acts_on in ("arm", "transmission", "actuator", "sensor")
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
        "actuator": effect.actuation(place, values),
        "transmission": effect.transmission(place, values),
        "sensor": effect.sensing(place, values),
    }
    if effect.tolerance:
        return
    assert [where for where, what in acting.items() if what is not None] == (
        [] if effect.acts_on == "arm" else [effect.acts_on]
    )
