"""The diagnosis does not know the plant on which it is tried: it works where there is none."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import cablesense_gap

TESTS = Path(__file__).parents[1]
PLANT = "cablesense_gap.plant"

WITHOUT_PLANT = f"""
import importlib, pkgutil, sys

class NoPlant:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == {PLANT!r} or name.startswith({PLANT!r} + "."):
            raise ModuleNotFoundError(f"{{name}}: there is no plant here")

sys.meta_path.insert(0, NoPlant)
try:
    import {PLANT}
except ModuleNotFoundError:
    pass
else:
    raise SystemExit("the plant can be imported, so the test shows nothing")
"""

EVERYTHING = """
import cablesense_gap

def walk(package):
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        if module.name != "cablesense_gap.plant":
            found = importlib.import_module(module.name)
            print(module.name)
            if module.ispkg:
                walk(found)

walk(cablesense_gap)
"""

A_DIAGNOSIS = """
sys.path.insert(0, "..")
from test_gap_diagnose import COURSE, LAB, made
from cablesense_gap.diagnose import diagnose
from cablesense_gap.simulator import Term

truth = {Term("payload", "segment_3", "mass_kg"): 0.5}
print(*diagnose(made(truth), LAB).verdict.effects)
assert not [name for name in sys.modules if name.startswith("cablesense_gap.plant")]
"""


def run(program: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_PLANT + program],
        cwd=TESTS / "gap",
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_every_other_part_can_be_imported_without_the_plant() -> None:
    folder = Path(cablesense_gap.__path__[0])
    files = [path.relative_to(folder).with_suffix("") for path in folder.rglob("*.py")]
    expected = {
        ".".join(["cablesense_gap", *(p for p in path.parts if p != "__init__")])
        for path in files
        if path.parts[0] != "plant"
    }
    assert {*run(EVERYTHING), "cablesense_gap"} == expected


@pytest.mark.slow  # the full library, from which to choose
def test_a_diagnosis_is_made_without_the_plant() -> None:
    assert run(A_DIAGNOSIS) == ["payload"]


def test_only_the_verb_that_withholds_may_import_the_plant() -> None:
    """Whoever widens the contract that `make lint` holds has to change this line as well."""
    text = (TESTS.parent / "pyproject.toml").read_text(encoding="utf-8")
    contracts = tomllib.loads(text)["tool"]["importlinter"]["contracts"]
    (protecting,) = [c for c in contracts if PLANT in c.get("protected_modules", [])]
    assert protecting["type"] == "protected"
    assert protecting["allowed_importers"] == ["cablesense_cli.gap"]
