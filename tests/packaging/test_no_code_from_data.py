"""Nothing in the packages makes code of data: no pickle, no eval, no shell, one reader of YAML."""

import ast
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[2]
PACKAGES = (
    "cablesense_msgs_py",
    "cablesense_sim",
    "training",
    "cablesense_gap",
    "examples",
    "cablesense_plants",
    "cablesense_ros",
)
SOURCES = sorted(path for package in PACKAGES for path in (CHECKOUT / package).rglob("*.py"))
MODULES = {"pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "code"}
BUILTINS = {"eval", "exec", "compile", "__import__"}
CALLS = {
    ("yaml", "load"): "cablesense_base/plain_yaml.py",
    ("yaml", "safe_load"): "",
    ("yaml", "full_load"): "",
    ("yaml", "unsafe_load"): "",
    ("torch", "load"): "",
    ("os", "system"): "",
    ("os", "popen"): "",
    ("tempfile", "mktemp"): "",
    ("pd", "read_pickle"): "",
}
"""What is called of what, and in which file alone it may be."""


def makers_of_code(path):
    """Lines of a file that make code of data, or may."""
    name = path.relative_to(CHECKOUT).as_posix()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        where = f"{name}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names]
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            yield from (where for one in names if one.split(".")[0] in MODULES)
        elif isinstance(node, ast.Call):
            function = node.func
            if isinstance(function, ast.Name) and function.id in BUILTINS:
                yield where
            if isinstance(function, ast.Attribute) and isinstance(function.value, ast.Name):
                allowed = CALLS.get((function.value.id, function.attr))
                if allowed is not None and allowed != name:
                    yield where
            for keyword in node.keywords:
                if keyword.arg in ("shell", "allow_pickle"):
                    yield where


@pytest.mark.parametrize("package", PACKAGES)
def test_no_package_makes_code_of_data(package):
    own = [path for path in SOURCES if path.is_relative_to(CHECKOUT / package)]
    assert own
    assert [line for path in own for line in makers_of_code(path)] == []
