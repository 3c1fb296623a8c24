"""docs/physics.md: every function and test that it names exists, and every equation has both."""

import ast
import importlib
import re
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[1]
TEXT = (CHECKOUT / "docs/physics.md").read_text(encoding="utf-8")
FUNCTIONS = sorted(set(re.findall(r"`(cablesense_\w+(?:\.\w+)+)`", TEXT)))
TESTS = sorted(set(re.findall(r"`(tests/\w+\.py)::(\w+)`", TEXT)))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_exists(name):
    module, _, function = name.rpartition(".")
    assert callable(getattr(importlib.import_module(module), function))


@pytest.mark.parametrize(("file", "name"), TESTS)
def test_every_test_exists(file, name):
    tree = ast.parse((CHECKOUT / file).read_text(encoding="utf-8"))
    assert name in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_equations_are_numbered_through():
    numbers = [int(number) for number in re.findall(r"\(P(\d+)\)$", TEXT, re.MULTILINE)]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) >= 10


@pytest.mark.parametrize("section", TEXT.split("\n## ")[1:], ids=lambda text: text.split("\n")[0])
def test_every_section_names_what_computes_and_what_checks(section):
    assert re.search(r"[Cc]omputed by\s+`cablesense_", section)
    assert re.search(r"[Cc]hecked by\s+`tests/", section)
