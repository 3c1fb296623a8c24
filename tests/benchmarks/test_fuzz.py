"""The fuzzer finds what it is for; some items of every target find nothing."""

import ctypes
import json
import os
import sys
import time
from pathlib import Path

import pytest

from cablesense_base import CableSenseError

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

import fuzz  # noqa: E402
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
    target = Target("bad", "files", make_bad, 16, 16, limit_s=1.0, growth_mb=200.0)
    result = run_watched(target, 0, 0, 16, lambda: done.append(1))
    assert (result.crashes, result.hangs, result.memory) == (2, 1, 1)
    assert (result.escaped, result.false_answers) == (1, 1)
    assert len(done) == result.items == 16
    assert result.inputs == result.refused == 10
    for item, kind in [
        (3, "crashes"),
        (5, "hangs"),
        (7, "memory"),
        (9, "KeyError"),
        (11, "force"),
    ]:
        assert any(f"item {item}:" in text and kind in text for text in result.findings)


def test_a_refusal_of_two_lines_is_a_finding():
    require_one_line(CableSenseError("one"))
    for text in ("", "two\nlines", "x" * 5000):
        with pytest.raises(FalseAnswerError):
            require_one_line(CableSenseError(text))


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_some_items_of_every_target_find_nothing():
    for target in fuzz.targets():
        run = target.make(0)
        outcomes = [run(item) for item in range(target.quick_items)]
        inputs, refused, taken = map(sum, zip(*outcomes, strict=True))
        assert inputs >= target.quick_items, target.name
        assert refused + taken > 0, target.name


@pytest.mark.slow
def test_its_report_counts_inputs_by_unit(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["fuzz.py", "--quick", "--only", "frames", "--json"])
    assert fuzz.main() == 0
    report = json.loads(capsys.readouterr().out)
    assert report["targets"]["frames"]["items"] == 12
    assert report["in all"]["CAN frames"] == report["targets"]["frames"]["inputs"] > 12
    assert report["in all"]["crashes"] == report["in all"]["files"] == 0
