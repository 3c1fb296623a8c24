"""The tutorial as someone types it; `benchmarks/tutorial_arms.py` does so on other arms."""

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.helpers.tutorial_page import PAGE, Step, differences, steps, typed

pytestmark = [pytest.mark.exports, pytest.mark.slow, pytest.mark.timeout(600)]

SHORTER = {"cablesense gap adapt": "cablesense gap adapt --workers 1"}
"""Without starting processes, of which each imports everything once more."""


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


@pytest.fixture(scope="module")
def tutorial(tmp_path_factory: pytest.TempPathFactory) -> Played:
    """Every line of the page, typed."""
    pytest.importorskip("torch")
    folder = tmp_path_factory.mktemp("tutorial")
    printed = []
    for step in steps(PAGE.read_text(encoding="utf-8")):
        lines = step.lines
        for given, short in SHORTER.items():
            lines = tuple(line.replace(given, short) for line in lines)
        printed.append((step, typed(lines, folder)))
    return Played(folder, printed)


def test_the_hidden_effect_is_found_and_the_estimator_repaired(tutorial: Played) -> None:
    verdict = tutorial.verdict()
    assert verdict["effects"] == ["sensor_gain"]
    assert verdict["where"]["cables"] == tutorial.hidden_places()
    before, after = (verdict["estimator"][when]["force_mae_n"] for when in ("before", "after"))
    assert after < 0.5 * before
    assert (tutorial.folder / "errors.png").is_file()


def test_the_page_says_what_its_commands_print(tutorial: Played) -> None:
    said = [step.printed for step, _ in tutorial.printed if step.printed is not None]
    assert len(said) == 4
    for step, text in tutorial.printed:
        if step.printed is not None:
            assert list(differences(step.printed, text)) == [], "make tutorial"
