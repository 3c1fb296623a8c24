"""The fuzzer finds what it is for; some seconds of it on every reader find nothing."""

import ctypes
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cablesense_base.errors import CableSenseError

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

from fuzz_watched import (  # noqa: E402
    FalseAnswerError,
    Outcome,
    Target,
    require_one_line,
    run_watched,
)


def make_bad(seed):
    """Item 3 crashes natively, 5 hangs, 7 grows, 9 raises, 11 answers falsely, 13 exits."""

    def run(item):
        if item == 3:
            ctypes.string_at(0)
        while item == 5:
            pass
        if item == 7:
            kept = b"x" * 400_000_000
            time.sleep(60.0)
            assert kept
        if item == 9:
            raise KeyError(item)
        if item == 11:
            raise FalseAnswerError("a force from nothing")
        if item == 13:
            os._exit(2)
        return Outcome(refused=1)

    return run


@pytest.mark.slow
def test_crashes_hangs_growth_errors_and_false_answers_are_found():
    done = []
    target = Target(
        "bad", "files", make_bad, items=16, quick_items=16, limit_s=4.0, growth_mb=200.0
    )
    result = run_watched(target, 0, 0, 16, done.append)
    assert (result.crashes, result.hangs, result.memory) == (2, 1, 1)
    assert (result.escaped, result.false_answers) == (1, 1)
    assert not result.clean
    assert sum(done) == result.items == 16
    assert result.inputs == result.refused == 10
    findings = "\n".join(result.findings)
    for item, what in [(3, "crashes"), (5, "hangs"), (7, "memory"), (9, "KeyError")]:
        assert f"item {item}: {what}" in findings or (
            f"item {item}:" in findings and what in findings
        )


def test_a_refusal_of_two_lines_is_a_finding():
    require_one_line(CableSenseError("one"))
    for text in ("", "two\nlines", "x" * 5000):
        with pytest.raises(FalseAnswerError):
            require_one_line(CableSenseError(text))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_some_seconds_of_it_find_nothing():
    command = [sys.executable, str(BENCHMARKS / "fuzz.py"), "--quick", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr[-2000:]
    report = json.loads(done.stdout)
    assert len(report["targets"]) == 12
    for result in report["targets"].values():
        assert result["inputs"] >= 8
        assert result["refused"] + result["taken"] > 0
