"""The folder of a report: claimed before anything runs, and whole at the end."""

import json
import os

import pytest
from paper_studies import DOT, ignore, study

from cablesense_paper.report import claim_folder, write_report
from cablesense_paper.study import PaperError, run_study


def failing(quick, tell):
    raise ZeroDivisionError


def test_a_new_folder_is_made_and_left_empty(tmp_path):
    folder = tmp_path / "a" / "b"
    claim_folder(folder)
    claim_folder(folder)
    assert list(folder.iterdir()) == []


def test_a_folder_that_holds_something_is_refused(tmp_path):
    (tmp_path / "mine.txt").touch()
    with pytest.raises(PaperError, match="is not empty"):
        claim_folder(tmp_path)


def test_a_place_that_cannot_be_a_folder_is_refused(tmp_path):
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(PaperError, match=r"cannot be written to \(.+\); give another --out"):
            claim_folder(place)


def test_it_holds_page_pictures_and_figures(tmp_path):
    outcomes = [run_study(study(), True, ignore), run_study(study(failing), True, ignore)]
    write_report(tmp_path, outcomes, quick=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "dot.png", "report.html", "results.json",
    ]  # fmt: skip
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


def test_its_files_are_replaced_and_never_written_over(tmp_path):
    outcomes = [run_study(study(), True, ignore)]
    (tmp_path / "former.png").write_bytes(b"former")
    os.link(tmp_path / "former.png", tmp_path / "dot.png")
    write_report(tmp_path, outcomes, quick=True)
    assert (tmp_path / "dot.png").read_bytes() == DOT
    assert (tmp_path / "former.png").read_bytes() == b"former"
