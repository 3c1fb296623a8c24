"""Compiled functions: the same numbers without Numba, and a word where somebody waits."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cablesense_sim.compiled import ANNOUNCEMENT

WITHOUT_NUMBA = """
import sys
sys.modules["numba"] = None
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == "numba" else found(name, *rest)
"""
INTERPRETED = "from cablesense_sim.compiled import leave_interpreted\nleave_interpreted()\n"
EQUILIBRIA = """
import json, sys
import numpy as np
from cablesense_sim import mechanism_of, open_arm, solve_equilibrium

answers = {}
for name in ("cdsm", "cdsm_lab", "cdsm_friction"):
    mechanism = mechanism_of(open_arm(name))
    rng = np.random.default_rng(4)
    command_rad = rng.uniform(-0.15, 0.15, (5, mechanism.joint_count))
    forces_n = rng.normal(0.0, 6.0, (5, mechanism.segment_count, 3))
    equilibrium = solve_equilibrium(mechanism, command_rad, forces_n)
    answers[name] = equilibrium.tensions_n.tolist()
print(json.dumps(answers))
print(sys.modules.get("numba") is not None)
"""


def run(script: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a script in a Python of its own."""
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", script],
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder)} if folder else None,
        capture_output=True,
        check=True,
        text=True,
        timeout=100,
    )


@pytest.mark.slow
@pytest.mark.parametrize("before", [WITHOUT_NUMBA, INTERPRETED], ids=["absent", "left out"])
def test_equilibria_are_the_same_as_python(before: str) -> None:
    answers, uses_numba = run(before + EQUILIBRIA).stdout.splitlines()
    compiled_answers, _ = run(EQUILIBRIA).stdout.splitlines()
    assert uses_numba == "False"
    expected = json.loads(compiled_answers)
    for name, tensions_n in json.loads(answers).items():
        np.testing.assert_allclose(tensions_n, expected[name], rtol=1e-7, atol=1e-6)


@pytest.mark.slow
def test_who_waits_for_a_compilation_is_told_once_and_the_next_does_not_wait(
    tmp_path: Path,
) -> None:
    module = tmp_path / "cablesense_example.py"
    module.write_text(
        "from cablesense_sim.compiled import compiled\n"
        "import cablesense_sim.compiled as home\n"
        "home._OWN = 'cablesense_example'\n"
        "@compiled\n"
        "def twice(number):\n"
        "    return 2.0 * number\n"
        "print(twice(3.0), twice(4))\n",
        encoding="utf-8",
    )
    script = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import cablesense_example"
    first = run(script, tmp_path / "cache")
    second = run(script, tmp_path / "cache")
    assert first.stdout == second.stdout == "6.0 8.0\n"
    assert first.stderr.splitlines() == [ANNOUNCEMENT]
    assert second.stderr == ""
