"""The tutorial as someone types it, on its arm and on one that is drawn at random."""

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import gap_arms
import numpy as np
import pytest
import yaml

from cablesense_sim.arm import Arm
from tests.helpers.tutorial_page import PAGE, Step, differences, steps, typed

pytestmark = [pytest.mark.exports, pytest.mark.slow, pytest.mark.timeout(600)]

SEGMENTS = 2
"""Of the drawn arm; more take longer."""
RATE_HZ = 2.0
SHORTER = {"cablesense gap adapt": "cablesense gap adapt --workers 1"}
"""Without starting processes, of which each imports everything once more."""

MAKES_THE_FILE = ("cablesense info --template", "sed ")
"""Lines that write or edit the arm file."""


@dataclass(frozen=True)
class Played:
    """What the lines of the page have printed, step by step, and the folder they were typed in."""

    folder: Path
    printed: list[tuple[Step, str]]

    def verdict(self) -> dict:
        """The verdict of the diagnosis."""
        return json.loads((self.folder / "adapted/verdict.json").read_text(encoding="utf-8"))

    def hidden_places(self) -> list[str]:
        """Where the plant has hidden the effect."""
        answers = self.folder / "bench/answers/answers.csv"
        (answer,) = csv.DictReader(answers.read_text(encoding="utf-8").splitlines())
        return answer["where"].split()


def drawn_arm(seed: int) -> Arm:
    """An arm of few segments among those that a seed draws, its sensors as the tutorial's."""
    rng = np.random.default_rng(seed)
    arm = gap_arms.draw_arm(rng)
    while arm.segments.count != SEGMENTS:
        arm = gap_arms.draw_arm(rng)
    sensors = arm.sensors.model_copy(update={"rate_hz": RATE_HZ})
    return arm.model_copy(update={"sensors": sensors})


def played(folder: Path, of_ones_own: Arm | None) -> Played:
    """Type every line; an arm of one's own takes the place of the edited template."""
    if of_ones_own is not None:
        text = yaml.safe_dump(of_ones_own.model_dump(mode="python"), sort_keys=False)
        (folder / "my_arm.yaml").write_text(text, encoding="utf-8")
    printed = []
    for step in steps(PAGE.read_text(encoding="utf-8")):
        lines = step.lines
        for given, short in SHORTER.items():
            lines = tuple(line.replace(given, short) for line in lines)
        if of_ones_own is not None:
            lines = tuple(line for line in lines if not line.startswith(MAKES_THE_FILE))
        printed.append((step, typed(lines, folder)))
    return Played(folder, printed)


@pytest.fixture(scope="module", params=["the page's arm", "a drawn arm"])
def tutorial(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Played:
    pytest.importorskip("torch")
    drawn = drawn_arm(seed=20261130) if request.param == "a drawn arm" else None
    return played(tmp_path_factory.mktemp("tutorial"), drawn)


def test_the_hidden_effect_is_found_and_the_estimator_repaired(tutorial: Played) -> None:
    verdict = tutorial.verdict()
    assert verdict["effects"] == ["sensor_gain"]
    assert verdict["where"]["cables"] == tutorial.hidden_places()
    before, after = (verdict["estimator"][when]["force_mae_n"] for when in ("before", "after"))
    assert after < 0.5 * before
    assert (tutorial.folder / "errors.png").is_file()


@pytest.mark.parametrize("tutorial", ["the page's arm"], indirect=True)
def test_the_page_says_what_its_commands_print(tutorial: Played) -> None:
    said = [step.printed for step, _ in tutorial.printed if step.printed is not None]
    assert len(said) == 4
    for step, text in tutorial.printed:
        if step.printed is not None:
            assert list(differences(step.printed, text)) == [], "make tutorial"
