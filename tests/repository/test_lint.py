"""What `make lint` runs finds nothing; here it runs beside the other tests."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.checkout import CHECKOUT

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

RECIPE = (CHECKOUT / "Makefile").read_text(encoding="utf-8").partition("\nlint:")[2]
LINTERS = re.findall(r"^\t\$\(BIN\)/(.+) \|\| failed=1; \\$", RECIPE.partition("\n\n")[0], re.M)
"""Their command lines, as they stand in the Makefile."""


def test_style_types_and_dependencies_are_looked_at() -> None:
    assert {line.split()[0] for line in LINTERS} == {"ruff", "mypy", "lint-imports"}


@pytest.mark.parametrize("line", LINTERS)
def test_a_linter_finds_nothing(line: str) -> None:
    program, *arguments = line.split()
    done = subprocess.run(
        [str(Path(sys.executable).with_name(program)), *arguments],
        cwd=CHECKOUT,
        capture_output=True,
        check=False,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
