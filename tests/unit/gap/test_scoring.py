"""Answers, folders of verdicts and the score sheet, against counts done by hand."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from cablesense_gap.scoring import (
    ScoreError,
    Truth,
    budget_score,
    places_right,
    read_answers,
    read_verdicts,
    score,
)
from cablesense_gap.verdict import Share, VerdictError, write_verdict
from cablesense_ros.cli.app import app
from tests.helpers.verdict_cases import gap_of, verdict_of

HEADER = "recording,effects,where\n"


def answers_of(tmp_path, text):
    path = tmp_path / "answers.csv"
    path.write_text(text, encoding="utf-8")
    return read_answers(path)


def test_effects_and_places_are_found_however_they_are_written(tmp_path):
    first, second = answers_of(
        tmp_path,
        "recording, effects, where, gap_over_floor\n"
        "rec_01, payload+base_tilt, , 7.5\n"
        'rec_02.csv,sensor_gain,"cable_3, cable_12",\n',
    )
    assert first == Truth("rec_01", ("base_tilt", "payload"), gap_over_floor=7.5)
    assert (second.recording, second.gap_over_floor) == ("rec_02", None)
    assert places_right(verdict_of("payload"), first.where) is None
    for cables, right in ((("cable_3", "cable_12"), True), (("cable_3",), False)):
        assert places_right(verdict_of("sensor_gain", cables=cables), second.where) is right


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "misses column recording"),
        ("recording,effects\na,none\n", "misses column where"),
        (HEADER, "no rows"),
        (HEADER + "a,none,\na,payload,\n", "stands twice"),
        (HEADER + "a,,\n", "row 1: effects"),
        (HEADER + "a,payload+payload,\n", "each once"),
        (HEADER + "a,none+payload,\n", "must stand alone"),
        (HEADER + "a,Payload!,\n", "must be names joined"),
        (HEADER + ",payload,\n", "names no recording"),
        ("recording,effects,where,gap_over_floor\na,none,,big\n", "gap_over_floor"),
        ("recording,effects,where,gap_over_floor\na,none,,-1\n", "gap_over_floor"),
    ],
)
def test_answers_that_cannot_be_are_refused_in_one_line(tmp_path, text, says):
    with pytest.raises(ScoreError, match=says) as refused:
        answers_of(tmp_path, text)
    assert "\n" not in str(refused.value)


def test_verdicts_lie_in_folders_or_as_files(tmp_path):
    (tmp_path / "rec_01").mkdir()
    write_verdict(tmp_path / "rec_01" / "verdict.json", verdict_of("none"))
    write_verdict(tmp_path / "rec_02.json", verdict_of("payload"))
    (tmp_path / "notes.json").write_text("{}")
    verdicts = read_verdicts(tmp_path, ["rec_01", "rec_02"])
    assert verdicts["rec_01"].effects == ("none",)
    assert verdicts["rec_02"].effects == ("payload",)
    with pytest.raises(ScoreError, match=r"no verdict on rec_03;"):
        read_verdicts(tmp_path, ["rec_01", "rec_03", "rec_04"])
    with pytest.raises(VerdictError):
        read_verdicts(tmp_path, ["notes"])
    write_verdict(tmp_path / "rec_01.json", verdict_of("payload"))
    with pytest.raises(ScoreError, match="keep one"):
        read_verdicts(tmp_path, ["rec_01"])
    with pytest.raises(ScoreError, match="no such folder"):
        read_verdicts(tmp_path / "nowhere", ["rec_01"])


def test_the_verb_prints_a_table_or_json(tmp_path):
    write_verdict(tmp_path / "a.json", verdict_of("payload", 0.8, segments=("segment_1",)))
    write_verdict(tmp_path / "b.json", verdict_of("none", 0.7))
    answers = tmp_path / "answers.csv"
    answers.write_text(HEADER + "a,payload,segment_1\nb,sensor_lag,cable_1\n")
    command = ["gap", "score", str(tmp_path), "--answers", str(answers)]
    table = CliRunner().invoke(app, command)
    assert table.exit_code == 0, table.output
    assert "singles exact" in table.output
    result = CliRunner().invoke(app, [*command, "--json"])
    figures = json.loads(result.stdout)
    assert figures["exact"]["value"] == 0.5
    assert figures["confusion"]["sensor_lag"] == {"none": 1}


def answer(name, effects, where="", **more):
    return Truth(name, tuple(effects.split("+")), where, **more)


ANSWERS = (
    answer("a", "payload", "segment_2", gap_over_floor=9.0),
    answer("b", "sensor_gain", "cable_3", gap_over_floor=2.0),
    answer("c", "sensor_gain", "cable_3 cable_5", gap_over_floor=20.0),
    answer("d", "base_tilt+payload"),
    answer("e", "base_tilt+payload"),
    answer("f", "none"),
    answer("g", "none"),
    answer("h", "unknown"),
)
VERDICTS = {
    "a": verdict_of("payload", 0.8, segments=("segment_2",), gap=gap_of(1.1, 0.1)),
    "b": verdict_of(
        "sensor_offset", 0.6, others={"sensor_gain": 0.4}, ambiguity_group=("sensor_gain",)
    ),
    "c": verdict_of("sensor_gain", 1.0, cables=("cable_3",), gap=gap_of(1.1, 0.2)),
    "d": verdict_of("payload", 0.7, others={"none": 0.2, "base_tilt+payload": 0.1}),
    "e": verdict_of("base_tilt+payload", 0.9, gap=gap_of(1.1, 0.3)),
    "f": verdict_of("none", 1.0, gap=gap_of(0.1, 0.1)),
    "g": verdict_of("unknown", 0.5),
    "h": verdict_of("unknown", 0.5),
    "nobody asked": verdict_of("cable_creep"),
}


def test_every_count_is_the_one_done_by_hand():
    scores = score(VERDICTS, ANSWERS)
    counts = {
        name: (getattr(scores, name).hits, getattr(scores, name).count)
        for name in (
            "exact",
            "top2",
            "truth_in_group",
            "singles_exact",
            "clear_singles_exact",
            "doubles_both",
            "doubles_one",
            "false_alarms",
            "unknown_recall",
            "where",
        )
    }
    assert counts == {
        "exact": (5, 8),  # a, c, e, f, h
        "top2": (6, 8),  # b too
        "truth_in_group": (6, 8),
        "singles_exact": (2, 3),
        "clear_singles_exact": (2, 2),
        "doubles_both": (1, 2),
        "doubles_one": (2, 2),
        "false_alarms": (1, 2),
        "unknown_recall": (1, 1),
        "where": (1, 2),  # a, and c lacks a cable
    }
    assert scores.cases == 8
    assert scores.wrong == ("b", "d", "g")
    assert scores.confusion["base_tilt+payload"] == {"payload": 1, "base_tilt+payload": 1}
    assert scores.confusion["none"] == {"none": 1, "unknown": 1}
    assert scores.by_effect["sensor_gain"].value == 0.5


def test_missing_verdicts_and_answers_are_refused():
    with pytest.raises(ScoreError, match="no verdict on z"):
        score(VERDICTS, [answer("z", "none")])
    with pytest.raises(ScoreError, match="no answers"):
        score(VERDICTS, [])


def test_budgets_count_effects_names_and_shares():
    shares = {
        name: Share(share_n=n, ci95_n=(0.0, 9.0), left_n=1.0, probability=0.9)
        for name, n in (("payload", 2.0), ("sensor_gain", 3.0))
    }
    cases = [
        (
            verdict_of("payload+sensor_gain", shares=shares),
            Truth("a", ("base_tilt", "payload", "sensor_lag"), each_gap_n=(0.1, 2.5, 1.0)),
        ),
        (verdict_of("unknown"), Truth("b", ("sensor_gain",), each_gap_n=(3.0,))),
        (verdict_of("payload"), Truth("c", ("unknown",), each_gap_n=(3.0,))),
    ]
    budget = budget_score(cases)
    assert (budget.named.hits, budget.named.count) == (1, 3)  # the tilt is below five floors
    assert (budget.false_names.hits, budget.false_names.count) == (1, 2)
    assert (budget.shares.hits, budget.shares.count) == (1, 1)
