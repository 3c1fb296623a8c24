"""The fuzzer finds what it is for; some examples of every target find nothing."""

import sys
from pathlib import Path

import fuzz
import hypothesis
import pytest
from fuzz_edits import FalseAnswerError, require_one_line
from hypothesis import strategies as st

from cablesense_base import CableSenseError

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
BAD = """
import ctypes, sys
sys.path.insert(0, {folder!r})
import fuzz
from fuzz_edits import FalseAnswerError, Outcome, Target
from hypothesis import strategies as st
def check(draw):
    if draw(st.integers(0, 3)) == 3:
        {fault}
    return Outcome(refused=1)
fuzz.targets = lambda: {{"bad": Target("files", check, 16)}}
sys.exit(fuzz.main())
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "found"),
    [
        ("ctypes.string_at(0)", "its process ended with -11"),
        ("raise FalseAnswerError('a force from nothing')", "a force from nothing"),
        ("pass", ""),
    ],
)
def test_crashes_and_false_answers_are_found(fault, found):
    command = [sys.executable, "-c", BAD.format(folder=str(BENCHMARKS), fault=fault)]
    done = fuzz.watch(command, "bad", 0, 16)
    assert bool(done["finding"]) == bool(found)
    assert found in done["finding"]
    if not found:
        assert done["examples"] == done["refused"] == 4


def test_a_refusal_of_two_lines_is_a_finding():
    require_one_line(CableSenseError("one"))
    for text in ("", "two\nlines", "x" * 5000):
        with pytest.raises(FalseAnswerError):
            require_one_line(CableSenseError(text))


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("name", fuzz.targets())
def test_some_examples_of_every_target_find_nothing(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    check, outcomes = fuzz.targets()[name].check, []

    @hypothesis.settings(max_examples=8, deadline=None, database=None)
    @hypothesis.given(st.data())
    def each(data):
        outcomes.append(check(data.draw))

    each()
    inputs, refused, taken = map(sum, zip(*outcomes, strict=True))
    assert inputs >= len(outcomes)
    assert refused + taken > 0
