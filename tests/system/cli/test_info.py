"""`cablesense info`: an arm, a model, the effects, what friction hides; JSON and tables agree."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from cablesense_gap.amended_arm import write_arm
from cablesense_ros.cli.app import app
from cablesense_ros.cli.options import print_result
from cablesense_sim.arm import Arm, parse_arm
from cablesense_sim.effects.registry import known_effects
from tests.helpers.arm_variants import variant
from tests.helpers.checkout import CHECKOUT

DOCS = CHECKOUT / "docs"


def shown(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["info", *arguments], env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    return result.output


def described(*arguments: str) -> dict:
    return json.loads(shown(*arguments, "--json"))


def test_an_arm_is_described_with_its_cables() -> None:
    arm = described("cdsm")
    assert arm["identity"].startswith("cdsm-")
    ends = [cable["ends_on_segment"] for cable in arm["cables"]]
    assert ends == [1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]
    assert [cable["angle_deg"] for cable in arm["cables"][3:6]] == [30.0, 270.0, 150.0]
    assert arm["cables"][0]["radius_m"] == pytest.approx(0.05)
    assert "9 cables" in shown("cdsm_table2")
    table = shown("cdsm_table2", "--verbose")
    assert "cable_9" in table
    assert "cable_10" not in table


@pytest.mark.parametrize("name", ["cdsm_lab", "config/models/cdsm_anywhere.onnx"])
def test_what_an_arm_or_a_model_is_takes_some_lines_without_keys(name: str) -> None:
    lines = shown(name).splitlines()
    assert len(lines) <= 9
    said = " ".join(lines)
    for key in ("noise_std_n", "stiffness_n_m", "size_bytes", "arm_identity"):
        assert key not in said


def test_effects_begin_with_a_list() -> None:
    lines = shown("--effects").splitlines()
    for name, effect in known_effects().items():
        assert any(name in line and effect.about in line for line in lines)
    assert shown("--effects", "--verbose").splitlines()[: len(lines) - 1] == lines[:-1]


def test_a_sample_rate_in_another_unit_is_questioned(tmp_path: Path) -> None:
    path = tmp_path / "slow.yaml"
    write_arm(path, variant({"sensors.rate_hz": 0.5}), "")
    question, *_ = described(str(path))["questions"]
    assert "sensors.rate_hz = 0.5" in question
    assert "500 if given in kHz" in question
    assert "questions" not in described("cdsm_lab")


def test_tolerances_that_may_take_cables_slack_are_questioned() -> None:
    (question,) = described("cdsm")["questions"]
    assert "are holes no more precise than 0.1 mm" in question


def test_tolerances_within_which_no_arm_finds_rest_are_questioned(monkeypatch) -> None:
    monkeypatch.setattr("cablesense_ros.cli.info.unloaded_scatter_n", lambda arm: None)
    assert "no arm that is built so finds rest" in described("cdsm_lab")["questions"][0]
    assert "built so, it finds no rest" in shown("cdsm_lab")


def test_a_model_states_what_it_was_made_for() -> None:
    model = described("config/models/peers/cdsm_two_stage.onnx")
    assert "tension_difference_n" in [port["name"] for port in model["inputs"]]
    assert model["metadata"]["arm_identity"].startswith("cdsm-")


def test_an_arm_file_shows_the_effects_that_it_lists(tmp_path: Path) -> None:
    gain = {"effect": "sensor_gain", "at": "cable_3", "parameters": {"gain": 0.04}}
    path = tmp_path / "odd.yaml"
    path.write_text(yaml.safe_dump(variant({"effects": [gain]}).model_dump()), encoding="utf-8")
    (listed,) = described(str(path))["effects"]
    assert listed == gain | {"parameters": {"gain": {"value": 0.04, "unit": "1"}}}
    assert described("cdsm")["effects"] == []


def test_the_catalogue_has_every_effect_with_its_parameters() -> None:
    listed = described("--effects")["effects"]
    table = shown("--effects", "--verbose")
    assert set(listed) == set(known_effects())
    for name, effect in known_effects().items():
        names = [parameter.name for parameter in effect.parameters]
        assert [parameter["name"] for parameter in listed[name]["parameters"]] == names
        assert listed[name]["source"] == effect.source
        assert all(name in table for name in names)


@pytest.mark.slow
def test_what_friction_hides_is_shown_by_segment() -> None:
    """A whole load that is hidden is no number."""
    hidden = described("cdsm_friction", "--blind", "--load-n", "5", "--bend-deg", "0")
    medians = [n["median"] for changes in hidden["segments"] for n in changes.values()]
    assert len(medians) == 16
    assert medians[2] is None  # at the first segment all of it may go unseen
    assert all(median is None or 0.0 < median <= 5.0 for median in medians)


@pytest.mark.slow
def test_what_tensions_tell_of_a_contact_depends_on_pose_segment_and_force(tmp_path: Path) -> None:
    picture = tmp_path / "bound.png"
    ten, forty = (
        described("cdsm", "--observability", "--load-n", load_n, *more)
        for load_n, more in (("10", ("--picture", str(picture))), ("40", ()))
    )
    straight = ten["straight"]
    bent = ten["joints within 5 degrees"]
    assert straight["segment 1"]["place_mm"] is None
    assert straight["segment 4"]["axial_n"] is None
    assert 0.0 < bent["segment 4"]["axial_n"] < 1.0
    for segment in ("segment 2", "segment 3", "segment 4"):
        # a place is known by a moment: four times the force, a quarter of the deviation
        places = [each["straight"][segment]["place_mm"] for each in (ten, forty)]
        assert places[1] == pytest.approx(places[0] / 4.0, rel=0.1)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_template_is_an_arm_and_the_docs_explain_each_key() -> None:
    parse_arm(shown("--template"))
    text = (DOCS / "arm_file.md").read_text(encoding="utf-8")
    for name, field in Arm.model_fields.items():
        parts = getattr(field.annotation, "model_fields", None)
        for key in [f"{name}.{part}" for part in parts] if parts else [name]:
            assert f"| `{key}" in text, key


def test_a_table_shows_every_value_of_a_result(capsys: pytest.CaptureFixture) -> None:
    result = {
        "model": "mine",
        "errors": {"mae_n": 0.25, "none": None},
        "rows": [{"segment": 1, "force_n": [1.5, 2.5]}, {"segment": 2, "force_n": [7.0, 7.0]}],
        "by_arm": {"soft": {"bins": [{"low_n": 3}], "rate": 1234.5678}},
    }
    print_result("Result", result, as_json=True)
    assert json.loads(capsys.readouterr().out) == result
    print_result("Result", result, as_json=False)
    table = capsys.readouterr().out
    for words in (
        "mine",
        "mean error, N 0.25; none –",
        "1.5, 2.5",
        "7 each",
        "soft",
        "low, N",
        "1235",
    ):
        assert words in table


def test_a_table_too_wide_for_a_terminal_is_parted_and_breaks_no_word(
    capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    entry = {
        f"{word}_magnitude_n": 1.0 for word in ("estimated", "recorded", "predicted", "other")
    }
    print_result("Result", {"rows": [entry, entry]}, as_json=False)
    table = capsys.readouterr().out
    assert max(map(len, table.splitlines())) <= 60
    assert table.count("magnitude,") == 4
    for word in ("estimated", "recorded", "predicted"):
        assert word in table
