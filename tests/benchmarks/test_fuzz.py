"""The fuzzer finds what it is for; some items of every target find nothing."""

import json
import sys
from pathlib import Path

import pytest

from cablesense_base import CableSenseError

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

import fuzz  # noqa: E402
from fuzz_mutation import FalseAnswerError, require_one_line  # noqa: E402

BAD = """
import ctypes, os, sys
sys.path.insert(0, {folder!r})
import fuzz
from fuzz_mutation import FalseAnswerError, ItemOutcome, Target
fuzz.ITEM_LIMIT_S, fuzz.GROWTH_LIMIT_MB = 1.0, 200.0
def make(seed):
    def run(item):
        if item == 3: ctypes.string_at(0)
        while item == 5: pass
        if item == 7: b"x" * 400_000_000
        if item == 9: raise KeyError(item)
        if item == 11: raise FalseAnswerError("a force from nothing")
        if item == 13: os._exit(2)
        return ItemOutcome(refused=1)
    return run
fuzz.targets = lambda: {{"bad": Target("files", make, 16, 16)}}
sys.exit(fuzz.main())
"""
"""Item 3 crashes natively, 5 hangs, 7 grows, 9 raises, 11 answers falsely, 13 exits."""


def test_crashes_hangs_growth_errors_and_false_answers_are_found():
    command = [sys.executable, "-c", BAD.format(folder=str(BENCHMARKS))]
    counts, findings = fuzz.watch(command, "bad", 0, 0, 16)
    assert counts == {
        "items": 16, "inputs": 10, "refused": 10, "taken": 0,
        "ended": 3, "escaped": 2, "false_answers": 1,
    }  # fmt: skip
    for item, text in [(7, "MemoryError"), (9, "KeyError"), (11, "a force from nothing")]:
        assert any(f"item {item}:" in found and text in found for found in findings)
    for item in (3, 5, 13):
        assert any(f"item {item}: its process ended" in found for found in findings)


def test_a_refusal_of_two_lines_is_a_finding():
    require_one_line(CableSenseError("one"))
    for text in ("", "two\nlines", "x" * 5000):
        with pytest.raises(FalseAnswerError):
            require_one_line(CableSenseError(text))


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("name", fuzz.targets())
def test_some_items_of_every_target_find_nothing(name):
    target = fuzz.targets()[name]
    outcomes = [target.make(0)(item) for item in range(target.quick_items)]
    inputs, refused, taken = map(sum, zip(*outcomes, strict=True))
    assert inputs >= target.quick_items
    assert refused + taken > 0


@pytest.mark.slow
def test_its_report_counts_inputs_by_unit(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["fuzz.py", "--quick", "--only", "frames"])
    assert fuzz.main() == 0
    report = json.loads(capsys.readouterr().out)
    assert report["targets"]["frames"]["items"] == 12
    assert report["in all"]["CAN frames"] == report["targets"]["frames"]["inputs"] > 12
    assert report["in all"]["ended"] == report["in all"]["files"] == 0
