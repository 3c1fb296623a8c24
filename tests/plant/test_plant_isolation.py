"""The diagnosis does not know the plant on which it is tried, nor the plant anything of it."""

from __future__ import annotations

import ast
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


def run(program: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_PLANT + program],
        cwd=TESTS / "gap",
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.slow
def test_every_other_part_can_be_imported_without_the_plant() -> None:
    folder = Path(cablesense_gap.__path__[0])
    files = [path.relative_to(folder).with_suffix("") for path in folder.rglob("*.py")]
    expected = {
        ".".join(["cablesense_gap", *(p for p in path.parts if p != "__init__")])
        for path in files
        if path.parts[0] != "plant"
    }
    assert {*run(EVERYTHING), "cablesense_gap"} == expected


def test_only_the_verb_that_withholds_may_import_the_plant() -> None:
    """Whoever widens the contract that `make lint` holds has to change this line as well."""
    text = (TESTS.parent / "pyproject.toml").read_text(encoding="utf-8")
    contracts = tomllib.loads(text)["tool"]["importlinter"]["contracts"]
    (protecting,) = [c for c in contracts if PLANT in c.get("protected_modules", [])]
    assert protecting["type"] == "protected"
    assert protecting["allowed_importers"] == ["cablesense_cli.blind"]


OTHERS = ("cablesense_sim", "cablesense_training", "cablesense_ros", "cablesense_gap")


def test_the_plant_imports_nothing_that_is_tested_on_it() -> None:
    """Not even by a way that the linter's list of modules leaves open."""
    for path in Path(cablesense_gap.__path__[0], "plant").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in getattr(node, "names", []) if alias.name]
            module = getattr(node, "module", None) or ""
            for name in [module, *(names if isinstance(node, ast.Import) else [])]:
                allowed = name.startswith("cablesense_gap.plant")
                assert allowed or not name.startswith(OTHERS), f"{path.name} imports {name}"
