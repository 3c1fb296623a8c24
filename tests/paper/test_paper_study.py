"""Studies: found by their files, run one by one, their results made of numbers and text."""

import importlib
import subprocess
import sys

import matplotlib.pyplot as plt
import pytest
from paper_studies import RESULT, failing, ignore, study

from cablesense_gap.report.style import style
from cablesense_paper import study_result
from cablesense_paper.study import (
    DRAWING,
    PaperError,
    all_studies,
    chosen_studies,
    require_drawing,
    run_study,
    study_names,
)
from cablesense_paper.study_result import PRINT_DPI, Agreement, filled

TEXT = {
    "lead": "It pulls {tension_n:.1f} N.",
    "pictures": {"dot": {"caption": "At {tension_n:.0f} N.", "alt": "a dot"}},
    "tables": [
        {"each": "arms", "caption": "{arm}", "head": ["cable", "at {arm}"], "rows": "rows"}
    ],
    "comparisons": [
        {"what": "tension", "ours": "{tension_n}", "theirs": 50.0, "unit": "N", "within": 0.1,
         "why": "k s"},
        {"what": "error", "ours": "{tension_n}", "theirs": 9.0, "unit": "N", "at_most": 9.0,
         "why": "it is large", "source": "closed form"},
        {"what": "share", "ours": "{tension_n}", "theirs": "over 9", "above": 9.0, "why": ""},
        {"what": "trend", "ours": "grows", "theirs": "grows", "agrees": "{trend}", "why": ""},
    ],
    "notes": ["One.", "{more}"],
}  # fmt: skip
NUMBERS = {
    "tension_n": 50.04,
    "arms": [{"arm": "left", "rows": [("a", 1.0)]}, {"arm": "right", "rows": [("b", 2.0)]}],
    "trend": Agreement.PARTLY,
    "more": ("Two.", "Three."),
}


def test_every_study_states_where_the_paper_has_it():
    studies = all_studies()
    assert sorted(one.name for one in studies) == list(study_names())
    assert [one.order for one in studies] == sorted({one.order for one in studies})
    for one in studies:
        assert one.title
        assert one.place
        assert "{" not in one.quick


def test_those_that_are_named_are_chosen_and_others_refused():
    names = study_names()
    assert [one.name for one in chosen_studies(names[:1])] == [names[0]]
    assert [one.name for one in chosen_studies(())] == [one.name for one in all_studies()]
    with pytest.raises(PaperError, match=r"no study 'fig99'; there are .*displacement"):
        chosen_studies(["displacement", "fig99"])


def test_listing_the_studies_loads_nothing_heavy():
    code = (
        "import sys; from cablesense_paper.study import all_studies; all_studies();"
        "print(*(m for m in ('rclpy', 'torch', 'mujoco', 'matplotlib', 'onnxruntime', 'jinja2')"
        " if m in sys.modules))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == ""


def test_a_study_receives_the_mode_and_reports_its_progress():
    modes, shares = [], []

    def run(quick, progress):
        modes.append(quick)
        progress(0.5)
        return RESULT

    outcome = run_study(study(run), True, shares.append)
    assert (modes, shares) == ([True], [0.5])
    assert outcome.result is RESULT
    assert outcome.failure == ""


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (PaperError("the cable broke"), "the cable broke"),
        (ModuleNotFoundError("no", name="torch"), "Python package torch"),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
    ],
)
def test_whatever_a_study_raises_is_part_of_its_outcome(error, text):
    outcome = run_study(failing(error), False, ignore)
    assert outcome.result is None
    assert text in outcome.failure


def test_ctrl_c_ends_everything():
    with pytest.raises(KeyboardInterrupt):
        run_study(failing(KeyboardInterrupt()), False, ignore)


@pytest.mark.parametrize("missing", DRAWING)
def test_a_missing_package_is_named_before_anything_runs(missing, monkeypatch):
    def import_module(name):
        if name == missing:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    require_drawing()
    monkeypatch.setattr(importlib, "import_module", import_module)
    with pytest.raises(ModuleNotFoundError) as caught:
        require_drawing()
    assert caught.value.name == missing


@pytest.mark.parametrize(
    ("ours", "theirs", "agreement"),
    [(1.0, 1.1, Agreement.YES), (1.0, 1.2, Agreement.NO), (float("nan"), 1.0, Agreement.NO)],
)
def test_two_numbers_agree_within_a_tolerance(ours, theirs, agreement):
    assert Agreement.within(ours, theirs, 0.1001) is agreement


@pytest.mark.parametrize(
    ("parts", "agreement"),
    [([True, True], Agreement.YES), ([True, False], Agreement.PARTLY), ([False], Agreement.NO)],
)
def test_a_whole_agrees_as_far_as_its_parts(parts, agreement):
    assert Agreement.of_parts(parts) is agreement


@pytest.mark.parametrize(
    ("template", "value"),
    [("{a}", 1.25), ("{a} N", "1.25 N"), ("{a:.1f} N", "1.2 N"), ("none", "none"), (3.0, 3.0)],
)
def test_a_template_of_one_field_stands_for_its_value(template, value):
    assert filled(template, {"a": 1.25}) == value


def test_a_result_is_made_of_text_numbers_and_figures(monkeypatch):
    monkeypatch.setattr(study_result, "read_study_text", lambda name: TEXT)
    with style():
        figures = {"dot": plt.figure(figsize=(3.0, 2.0))}
        result = study_result.study_result("any", NUMBERS, figures)
    assert plt.get_fignums() == []
    assert result.lead == "It pulls 50.0 N."
    (picture,) = result.pictures
    assert (picture.name, picture.caption) == ("dot", "At 50 N.")
    assert int.from_bytes(picture.png[16:20], "big") == round(3.0 * PRINT_DPI)
    assert [(table.caption, table.head[1], table.rows) for table in result.tables] == [
        ("left", "at left", (("a", 1.0),)),
        ("right", "at right", (("b", 2.0),)),
    ]
    assert [c.agreement for c in result.comparisons] == ["yes", "no", "yes", "partly"]
    assert result.comparisons[0].ours == 50.04
    assert result.comparisons[1].source == "closed form"
    assert result.notes == ("One.", "Two.", "Three.")
