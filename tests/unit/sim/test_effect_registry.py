"""Effects are found, checked and ordered; another package can offer one."""

from __future__ import annotations

import importlib
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.report.text import causes_and_advice, headline
from cablesense_gap.simulator import Term
from cablesense_ros.cli.app import app
from cablesense_sim.arm import ArmFileError, open_arm, parse_arm
from cablesense_sim.course import Course
from cablesense_sim.effects.registry import EffectError, known_effects
from cablesense_sim.replay import replay_arm
from tests.helpers.arm_variants import variant
from tests.helpers.effect_arms import STRAIGHT, push
from tests.helpers.gap_recordings import LAB, small_recording
from tests.helpers.verdict_cases import verdict_of

GAIN = {"effect": "sensor_gain", "at": "cable_3", "parameters": {"gain": 0.04}}
CREEP = {"effect": "cable_creep", "parameters": {"share": 0.2}}


def with_effects(*listed: Any) -> Any:
    return variant({"effects": list(listed)}, "cdsm_lab")


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
        (GAIN | {"parameters": {"gian": 0.1}}, "no parameter 'gian'; it has gain"),
        (GAIN | {"parameters": {"gain": 0.6}}, "gain = 0.6 1 must be from -0.5 to 0.5"),
        (CREEP | {"parameters": {"time_s": 0.0}}, "time_s = 0 s must be from 0.5 to 3000"),
        (GAIN | {"parameters": {"gain": True}}, "= True: must be a number"),
        (GAIN | {"parameters": {"gain": math.nan}}, "finite"),
        (GAIN | {"size": 3}, "size"),
        ({"at": "cable_3"}, "effect"),
    ],
)
def test_an_entry_that_cannot_be_is_refused_in_one_line(listed: Any, words: str) -> None:
    with pytest.raises(ArmFileError, match=words) as caught:
        with_effects(listed)
    assert "\n" not in str(caught.value)


DOUBLED = """
from cablesense_sim.effects.effect import Effect, Parameter, Sensing, cables, chosen

class Doubled(Effect):
    name = "{name}"
    acts_on = "sensor"
    about = "sensors that count everything several times"
    source = "none"
    advice = "Read the manual."
    order = -5  # before a leak into other channels
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


@pytest.fixture
def doubled(package: Path) -> None:
    package.write_text(DOUBLED.format(name="sensor_doubled"))


@pytest.mark.usefixtures("doubled")
def test_an_arm_that_lists_it_is_replayed_with_it_in_its_order() -> None:
    entry = {"effect": "sensor_doubled", "at": "cable_2", "parameters": {"more": 1.0}}
    leak = {
        "effect": "sensor_crosstalk",
        "at": "cable_2_into_cable_3",
        "parameters": {"share": 0.1},
    }
    run = Course(np.array([0.0]), STRAIGHT[None], push(1, [0.0, 9.0, 0.0])[None])
    plain = replay_arm(variant({}, "cdsm_lab"), run)[0]
    read = replay_arm(variant({"effects": [leak, entry]}, "cdsm_lab"), run)[0]
    expected = plain * (1.0 + (np.arange(12) == 1))
    expected[2] += 0.1 * expected[1]
    np.testing.assert_allclose(read, expected)


@pytest.mark.usefixtures("doubled")
def test_the_catalogue_lists_it_the_diagnosis_simulates_it_and_the_report_words_it() -> None:
    shown = CliRunner().invoke(app, ["info", "--effects", "--json"])
    assert "sensor_doubled" in json.loads(shown.output)["effects"]
    simulator = ArmSimulator(LAB, small_recording().rows(slice(0, 2)))
    assert "sensor_doubled" in {candidate.effect for candidate in simulator.candidates}
    plain, read = (
        simulator.predict([variant])[0]
        for variant in ({}, {Term("sensor_doubled", "cable_2", "more"): 0.5})
    )
    expected = plain * (1.0 + 0.5 * (np.arange(12) == 1))
    np.testing.assert_allclose(read, expected, rtol=1e-9)
    verdict = verdict_of("sensor_doubled", 0.95, cables=("cable_2",))
    assert headline(verdict) == (
        "The gap comes from sensors that count everything several times, at cable 2 (95 % sure)."
    )
    assert causes_and_advice(verdict)[0][1] == "Read the manual."


def test_a_name_that_is_taken_is_refused(package: Path) -> None:
    package.write_text(DOUBLED.format(name="sensor_gain"))
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
