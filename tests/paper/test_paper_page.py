"""The page: well-formed, standing alone, with what agrees and what failed."""

import pytest
from html_page import Page
from paper_studies import RESULT, ignore, study

from cablesense_paper.report import paper_page, shown
from cablesense_paper.study import run_study


def outcome(run=None, **about):
    return run_study(study(run, **about), True, ignore)


def failing(quick, tell):
    raise ZeroDivisionError("the <cable> broke")


@pytest.fixture(scope="module")
def page():
    return Page(paper_page([outcome(), outcome(failing, name="rope")], quick=True))


def test_it_shows_what_was_found_word_by_word(page):
    assert page.h1 == "The paper, reproduced"
    for words in (
        RESULT.lead,
        "Fig. 3 of the paper.",
        "Two cables.",
        "1e7 N/m",
        "about 100",
        "It is the stiffness.",
        "The paper is silent on the amplitude.",
        "cablesense paper --only cable",
    ):
        assert words in page.text, words


def test_it_counts_what_agrees_with_the_paper_and_with_closed_forms(page):
    text = " ".join(page.text.split())
    assert "1of the paper’s figures and statements met" in text
    assert "1met in part" in text
    assert "0not met" in text
    assert "1 of 1checks against closed forms and other parts met" in text
    assert "0.5 closed form" in text


def test_it_stands_alone(page):
    pictures = [source for source in page.sources if not source.startswith("#")]
    assert len(pictures) == 1
    assert pictures[0].startswith("data:image/png;base64,")


def test_a_failure_is_told_at_its_head_and_in_its_place(page):
    assert "One study has failed" in page.text
    assert "the <cable> broke" in page.text


def test_quick_mode_says_what_it_took_less_of(page):
    assert "Quick mode: half the cables" in page.text
    whole = Page(paper_page([outcome()], quick=False))
    assert "half the cables" not in whole.text
    assert "Quick mode" not in whole.text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (-0.12345, "−0.1235"),
        (50.0, "50"),
        (1e7, "1e7"),
        (-2.5e-9, "−2.5e−9"),
        ("none", "none"),
    ],
)
def test_numbers_are_short_and_have_a_true_minus(value, text):
    assert shown(value) == text
