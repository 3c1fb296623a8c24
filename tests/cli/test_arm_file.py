"""The arm file's template and reference: complete, true, and as the docs have them."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cablesense_ros.cli.app import app
from cablesense_ros.cli.arm_file import arm_keys_markdown, arm_template
from cablesense_sim.arm import parse_arm

DOCS = Path(__file__).parents[2] / "docs"


def test_the_template_is_an_arm_and_each_of_its_lines_is_explained() -> None:
    arm = parse_arm(arm_template())
    assert arm.sensors.range_n is not None
    for row in arm_keys_markdown().splitlines()[2:]:
        key, _, valid, _, what = (cell.strip() for cell in row.strip("| ").split(" | "))
        assert valid, key
        assert what, key


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("segments.count", "whole number from 1 to 16"),
        ("segments.length_m", "above 0, to 5, or a list with one for each segment"),
        ("sensors.noise_std_n", "| N | number from 0 to 1000 |"),
        ("cables.unilateral", "`true`"),
    ],
)
def test_a_key_has_its_bounds(key: str, words: str) -> None:
    (row,) = (row for row in arm_keys_markdown().splitlines() if row.startswith(f"| `{key}` |"))
    assert words in row


def test_the_docs_have_the_table_of_now() -> None:
    shown = CliRunner().invoke(app, ["info", "--keys"]).stdout
    assert shown.strip() in (DOCS / "arm_file.md").read_text(encoding="utf-8")
