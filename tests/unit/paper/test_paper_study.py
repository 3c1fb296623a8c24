"""Studies: found by their files, run one by one, their results made of numbers and text."""

import matplotlib.pyplot as plt
import pytest

from cablesense_gap.report.style import style
from paper import study as studies
from paper.study import PRINT_DPI, PaperError, chosen_studies, run_study, study_names, study_result
from tests.helpers.paper_studies import failing, ignore

TEXT = {
    "lead": "It pulls {tension_n:.1f} N.",
    "pictures": {"dot": {"caption": "At {tension_n:.0f} N.", "alt": "a dot"}},
    "tables": [
        {"each": "arms", "caption": "{arm}", "head": ["cable", "at {arm}"], "rows": "{rows}"}
    ],
    "comparisons": [
        {
            "what": "tension",
            "ours": "{tension_n}",
            "theirs": 50.0,
            "unit": "N",
            "within": 0.1,
            "why": "k s",
        },
        {
            "what": "error",
            "ours": "{tension_n}",
            "theirs": 9.0,
            "unit": "N",
            "at_most": 9.0,
            "why": "it is large",
            "source": "closed form",
        },
        {"what": "share", "ours": "{tension_n}", "theirs": "over 9", "above": 9.0, "why": ""},
        {"what": "trend", "ours": "grows", "theirs": "grows", "agrees": "{trend}", "why": ""},
    ],
    "notes": ["One.", "{more}"],
}
NUMBERS = {
    "tension_n": 50.04,
    "arms": [{"arm": "left", "rows": [("a", 1.0)]}, {"arm": "right", "rows": [("b", 2.0)]}],
    "trend": "partly",
    "more": ("Two.", "Three."),
}


def test_every_study_states_where_the_paper_has_it():
    every = chosen_studies()
    assert sorted(one.name for one in every) == list(study_names())
    assert [one.order for one in every] == sorted({one.order for one in every})
    for one in every:
        assert one.title
        assert one.place
        assert "{" not in one.quick


def test_those_that_are_named_are_chosen_and_others_refused():
    names = study_names()
    assert [one.name for one in chosen_studies(names[:1])] == [names[0]]
    with pytest.raises(PaperError, match=r"no study 'fig99'; there are .*displacement"):
        chosen_studies(["displacement", "fig99"])


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


def test_a_result_is_made_of_text_numbers_and_figures(monkeypatch):
    monkeypatch.setattr(studies, "read_study_text", lambda name: TEXT)
    open_before = plt.get_fignums()
    with style():
        figures = {"dot": plt.figure(figsize=(3.0, 2.0))}
        result = study_result("any", NUMBERS, figures)
    assert plt.get_fignums() == open_before
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
