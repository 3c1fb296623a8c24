"""The report: a page that stands alone, and a folder claimed first and written whole."""

import json
import os

import pytest

from paper.report import claim_folder, paper_page, write_report
from paper.study import PaperError, run_study
from tests.helpers.html_page import Page
from tests.helpers.paper_studies import DOT, RESULT, failing, ignore, study

BROKEN = ZeroDivisionError("the <cable> broke")


def outcomes():
    return [run_study(one, True, ignore) for one in (study(), failing(BROKEN))]


@pytest.fixture(scope="module")
def page():
    return Page(paper_page(outcomes(), quick=True))


def test_the_page_shows_the_result_in_full(page):
    assert page.h1 == "The paper, reproduced"
    for text in (
        RESULT.lead,
        "Fig. 3 of the paper.",
        "Two cables.",
        "1e7 N/m",
        "about 100",
        "It is the stiffness.",
        "The paper is silent on the amplitude.",
        "python -m paper --only cable",
    ):
        assert text in page.text, text


def test_it_counts_what_agrees_with_the_paper_and_with_closed_forms(page):
    text = " ".join(page.text.split())
    assert "1of the paper’s figures and statements met" in text
    assert "1met in part" in text
    assert "0not met" in text
    assert "1 of 1checks against closed forms and other parts met" in text
    assert "0.5 closed form" in text


def test_a_failure_is_stated_at_its_head_and_in_its_place(page):
    assert "One study has failed" in page.text
    assert "the <cable> broke" in page.text


def test_quick_mode_states_what_it_reduces(page):
    assert "Quick mode: half the cables" in page.text
    whole = Page(paper_page(outcomes(), quick=False))
    assert "half the cables" not in whole.text
    assert "Quick mode" not in whole.text


def test_a_folder_that_holds_something_is_refused(tmp_path):
    (tmp_path / "mine.txt").touch()
    with pytest.raises(PaperError, match="is not empty"):
        claim_folder(tmp_path)
    claim_folder(tmp_path, force=True)
    os.mkfifo(tmp_path / "report.html")
    with pytest.raises(PaperError, match="is a device or a pipe"):
        claim_folder(tmp_path, force=True)


def test_a_place_that_cannot_be_a_folder_is_refused(tmp_path):
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(PaperError, match=r"cannot be written to \(.+\); give another --out"):
            claim_folder(place)


def test_the_folder_holds_page_pictures_and_numbers(tmp_path):
    write_report(tmp_path, outcomes(), quick=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "dot.png",
        "report.html",
        "results.json",
    ]
    assert (tmp_path / "dot.png").read_bytes() == DOT
    results = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    first, second = results["studies"]
    assert results["quick"] is True
    assert first["reduced"] == "half the cables"
    assert first["pictures"] == [{"file": "dot.png", "caption": "Fig. 3 of the paper."}]
    assert first["comparisons"][0]["ours"] == 1e7
    assert first["comparisons"][1]["agreement"] == "partly"
    assert "ZeroDivisionError" in second["failure"]
    assert "comparisons" not in second
