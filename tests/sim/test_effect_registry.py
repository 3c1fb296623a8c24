"""The catalogue: what every effect says of itself, and effects of other packages."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from arm_variants import variant
from effect_arms import STRAIGHT, push

from cablesense_sim.effects.effect import Effect
from cablesense_sim.effects.registry import EffectError, known_effects
from cablesense_sim.replay import replay_arm

FINDINGS = {
    "capstan_friction", "joint_friction", "cable_creep", "cable_stiffness", "actuator_backlash",
    "sensor_gain", "sensor_offset", "sensor_drift", "sensor_crosstalk", "sensor_lag", "payload",
    "base_tilt", "routing_geometry", "contact_offset", "joint_elasticity", "pretension_error",
}  # fmt: skip

STRANGER = """
from cablesense_sim.effects.effect import Effect, Parameter, cables, chosen
from cablesense_sim.effects.effect import Sensing

class Doubled(Effect):
    name = "{name}"
    acts_on = "sensor"
    about = "a sensor that counts everything so many times more"
    source = "none"
    parameters = (Parameter("more", "1", 0.0, 9.0, 1.0, "times"),)

    def places(self, segment_count, cable_count):
        return cables(cable_count)

    def sensing(self, place, values):
        return _Doubled(place, values["more"])

class _Doubled(Sensing):
    def __init__(self, place, more):
        self._place, self._more = place, more

    def step(self, time_s, tensions_n):
        here = chosen(self._place, tensions_n.shape[-1])
        return tensions_n * (1.0 + self._more[:, None] * here)
"""


def effects() -> list[Effect]:
    return list(known_effects().values())


def test_every_name_of_the_contract_is_there_and_tolerances_besides() -> None:
    assert {e.name for e in effects() if not e.tolerance} == FINDINGS
    assert {e.name for e in effects() if e.tolerance} == {"cable_tolerance", "segment_tolerance"}


@pytest.mark.parametrize("effect", effects(), ids=lambda e: e.name)
def test_an_effect_says_what_it_is(effect: Effect) -> None:
    assert effect.about
    assert not effect.about.endswith(".")
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


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path, as a package manager leaves it, for a package `stranger`."""
    info = tmp_path / "stranger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[cablesense.effects]\nx = stranger_effect:Doubled\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "stranger_effect", raising=False)
    importlib.invalidate_caches()
    known_effects.cache_clear()
    yield tmp_path / "stranger_effect.py"
    sys.modules.pop("stranger_effect", None)
    known_effects.cache_clear()


def test_an_effect_of_another_package_is_one_like_any_other(package: Path) -> None:
    package.write_text(STRANGER.format(name="sensor_doubled"))
    assert "sensor_doubled" in known_effects()
    listed = {"effect": "sensor_doubled", "at": "cable_2", "parameters": {"more": 1.0}}
    course = np.array([0.0]), STRAIGHT[None], push(1, [0.0, 9.0, 0.0])[None]
    doubled = replay_arm(variant({"effects": [listed]}, "cdsm_lab"), *course)
    plain = replay_arm(variant({}, "cdsm_lab"), *course)
    np.testing.assert_allclose(doubled / plain, 1.0 + (np.arange(12) == 1)[None])


def test_a_name_that_is_taken_is_refused(package: Path) -> None:
    package.write_text(STRANGER.format(name="sensor_gain"))
    with pytest.raises(EffectError, match=r"sensor_gain of stranger_effect:Doubled.*taken"):
        known_effects()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("raise OSError('no disk')", "stranger_effect:Doubled: no disk"),
        ("", "stranger_effect:Doubled: .*Doubled"),
        ("Doubled = 3", "is no class of effect"),
        ("class Doubled: name = 'x'", "is no class of effect"),
    ],
)
def test_what_is_no_effect_is_refused_with_where_it_came_from(
    package: Path, text: str, words: str
) -> None:
    package.write_text(text)
    with pytest.raises(EffectError, match=words):
        known_effects()
