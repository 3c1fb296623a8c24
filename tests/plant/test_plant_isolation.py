"""The plants share no code with what is tried on them."""

from __future__ import annotations

import ast
from pathlib import Path

import cablesense_plants

ALLOWED = ("cablesense_plants", "cablesense_base")


def test_a_plant_imports_nothing_that_is_tested_on_it() -> None:
    """Not even late or by a way that the import contracts leave open."""
    for path in Path(cablesense_plants.__path__[0]).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in getattr(node, "names", [])]
            module = getattr(node, "module", None) or ""
            for name in [module, *(names if isinstance(node, ast.Import) else [])]:
                allowed = name.startswith(ALLOWED) or not name.startswith("cablesense")
                assert allowed, f"{path.name} imports {name}"
