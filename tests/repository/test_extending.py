"""The patches of docs/extending.md apply to this version, are as the linters want, and work."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.checkout import CHECKOUT

PAGE = (CHECKOUT / "docs/extending.md").read_text(encoding="utf-8")
SECTIONS = dict(section.split("\n", maxsplit=1) for section in PAGE.split("\n## ")[1:])
"""Text of each section by its heading."""
NEEDED = (
    ".ci",
    "benchmarks",
    "cablesense_*",
    "config",
    "docs",
    "examples",
    "tests",
    "training",
    "[!.]*.*",
)
"""What the patches change, and what the tests that the page names need."""


def patch_of(section: str) -> str:
    """The diffs of a section, one after the other."""
    return "".join(re.findall(r"```diff\n(.*?)```", section, re.DOTALL))


def run_in(folder: Path, *command: str, given: str = "") -> subprocess.CompletedProcess[str]:
    """A command in a folder outside any repository, with the packages there."""
    environment = os.environ | {
        "GIT_CEILING_DIRECTORIES": str(folder.parent),
        "NUMBA_DISABLE_JIT": "1",  # a copy would compile for longer than it runs
        "PYTHONPATH": str(folder),
    }
    return subprocess.run(
        command,
        cwd=folder,
        env=environment,
        input=given,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What of the repository the patches concern, in another folder."""
    folder = tmp_path_factory.mktemp("extended")
    unneeded = shutil.ignore_patterns("__pycache__", "*.egg-info", "peers", "*.png", "*.gif")
    for pattern in NEEDED:
        for path in CHECKOUT.glob(pattern):
            if path.is_dir():
                shutil.copytree(path, folder / path.name, ignore=unneeded, dirs_exist_ok=True)
            else:
                shutil.copy2(path, folder)
    return folder


@pytest.mark.slow
def test_every_kind_of_addition_is_a_patch_that_applies(copied: Path) -> None:
    for heading, section in SECTIONS.items():
        applied = run_in(copied, "git", "apply", "--check", given=patch_of(section))
        assert applied.returncode == 0, f"{heading}: {applied.stderr}"


@pytest.mark.slow
def test_all_of_them_together_pass_linters_and_the_tests_that_the_page_names(copied: Path) -> None:
    applied = run_in(copied, "git", "apply", given=patch_of(PAGE))
    assert applied.returncode == 0, applied.stderr
    reference = run_in(copied, sys.executable, ".ci/reference")  # make reference
    assert reference.returncode == 0, reference.stderr
    (copied / "docs/ros_reference.md").write_text(reference.stdout, encoding="utf-8")
    assert all("\npytest " in section for section in SECTIONS.values())
    named_tests = shlex.split(" ".join(re.findall(r"(?m)^pytest (.*)$", PAGE)))
    python = sys.executable
    for command in (
        [python, "-m", "ruff", "check"],
        [python, "-m", "ruff", "format", "--check"],
        [str(Path(python).with_name("lint-imports")), "--no-logo"],
        [python, "-m", "pytest", "-q", "-p", "no:cacheprovider", *named_tests],
    ):
        done = run_in(copied, *command)
        assert done.returncode == 0, done.stdout + done.stderr
