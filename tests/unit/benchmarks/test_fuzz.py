"""The fuzzer finds what it is for; some examples of every target find nothing."""

import ctypes

import fuzz
import hypothesis
import pytest
from fuzz_edits import FalseAnswerError, Tally, require_one_line
from hypothesis import strategies as st

from cablesense_base import CableSenseError


def crash(draw):
    if draw(st.integers(0, 3)) == 3:
        ctypes.string_at(0)
    return Tally(refused=1)


def false_answer(draw):
    if draw(st.integers(0, 3)) == 3:
        raise FalseAnswerError("a force from nothing")
    return Tally(refused=1)


def no_fault(draw):
    draw(st.integers(0, 3))
    return Tally(refused=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("check", "found"),
    [(crash, "Segmentation fault"), (false_answer, "a force from nothing"), (no_fault, "")],
)
def test_crashes_and_false_answers_are_found(check, found):
    done = fuzz.watched(check, "target", 0, 16)
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
@pytest.mark.parametrize("name", fuzz.TARGETS)
def test_some_examples_of_every_target_find_nothing(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    check = fuzz.TARGETS[name].check
    outcomes = []

    @hypothesis.settings(max_examples=8, deadline=None, database=None)
    @hypothesis.given(st.data())
    def each(data):
        outcomes.append(check(data.draw))

    each()
    inputs, refused, taken = map(sum, zip(*outcomes, strict=True))
    assert inputs >= len(outcomes)
    assert refused + taken > 0
