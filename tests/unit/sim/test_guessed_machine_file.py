"""The machine file that a model suggests: what it reads, where it is touched, what may rub."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from cablesense_sim.machine.guess import guessed_machine_file
from cablesense_sim.machine.machine import open_machine
from tests.helpers.checkout import CHECKOUT

MODELS = CHECKOUT / "config/machines"


def guessed(name: str) -> dict:
    return yaml.safe_load(guessed_machine_file(MODELS / f"{name}.xml"))


@pytest.mark.parametrize("name", ["finger", "hand", "seven_hinges", "continuum"])
def test_tendons_that_hold_a_pose_may_rub(name):
    assert guessed(name)["cables"]["friction_coefficient"] > 0.0


def test_a_machine_without_tendons_has_nothing_that_rubs():
    assert "cables" not in guessed("six_axis")


def test_a_guess_opens(tmp_path: Path):
    for file in MODELS.glob("finger*"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "finger.yaml"
    path.write_text(guessed_machine_file(tmp_path / "finger.xml"), encoding="utf-8")
    machine = open_machine(path)
    assert machine.channels.names == ("flexor_deep", "extensor", "flexor_left", "flexor_right")
