"""What `cablesense info` shows of effects: the catalogue, an arm file's, what friction hides."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from arm_variants import variant
from typer.testing import CliRunner

from cablesense_ros.cli.app import app
from cablesense_sim.effects.registry import known_effects


def shown(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["info", *arguments])
    assert result.exit_code == 0, result.output
    return result.output


def test_the_catalogue_has_every_effect_with_its_parameters() -> None:
    listed = {
        effect["name"]: effect for effect in json.loads(shown("--effects", "--json"))["effects"]
    }
    assert set(listed) == set(known_effects())
    for name, effect in known_effects().items():
        assert [p["name"] for p in listed[name]["parameters"]] == [
            p.name for p in effect.parameters
        ]
        assert listed[name]["source"] == effect.source


def test_the_catalogue_reads_well_in_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    text = shown("--effects")
    assert "payload: mass that nobody modelled" in text
    assert "mass_kg" in text
    assert "at: segment_1, segment_2, segment_3, segment_4" in text
    assert "a tolerance and no finding" in text


def test_an_arm_file_shows_what_it_lists(tmp_path: Path) -> None:
    gain = {"effect": "sensor_gain", "at": "cable_3", "parameters": {"gain": 0.04}}
    path = tmp_path / "odd.yaml"
    path.write_text(yaml.safe_dump(variant({"effects": [gain]}).model_dump()), encoding="utf-8")
    listed = json.loads(shown(str(path), "--json"))["effects"]
    assert listed == [
        {
            "effect": "sensor_gain",
            "at": "cable_3",
            "parameters": {"gain": {"value": 0.04, "unit": "1"}},
        }
    ]
    assert "gain = 0.04" in shown(str(path))


def test_an_arm_without_effects_shows_none() -> None:
    assert json.loads(shown("cdsm", "--json"))["effects"] == []
    assert "Effects" not in shown("cdsm")


@pytest.mark.slow
def test_what_friction_hides_is_shown_by_segment() -> None:
    """JSON and table have the same figures; a whole load that is hidden is no number."""
    asked = ("cdsm_friction", "--blind", "--load-n", "5", "--bend-deg", "0")
    hidden, table = json.loads(shown(*asked, "--json")), shown(*asked)
    medians = [n["median"] for changes in hidden["segments"] for n in changes.values()]
    assert len(medians) == 16
    assert medians[2] is None  # at the first segment all of it may go unseen
    assert "> 5" in table
    assert all(f"{median:.2f}" in table for median in medians if median is not None)
