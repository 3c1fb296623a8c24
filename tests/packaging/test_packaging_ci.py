"""The script of continuous integration ends with pytest's summary and with the checks' verdict."""

import os
import subprocess
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("verdict", [0, 2])
def test_the_last_line_is_the_summary_and_the_exit_code_is_that_of_make(
    tmp_path: Path, verdict: int
) -> None:
    complaint = "echo 'make: *** Error' >&2" if verdict else ":"
    for name, body in {
        "make": f"echo running; echo '3 passed'; {complaint}; exit {verdict}",
        "chromium": "exit 0",  # so that nothing is installed
    }.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{body}\n")
        (tmp_path / name).chmod(0o755)
    done = subprocess.run(
        [CHECKOUT / ".ci/run"],
        env={**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
        text=True,
    )
    assert done.returncode == verdict
    assert "running" in done.stdout
    assert done.stdout.splitlines()[-1] == "3 passed"
