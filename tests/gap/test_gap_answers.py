"""Answers and folders of verdicts as files."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner
from verdict_cases import verdict_of

from cablesense_cli.app import app
from cablesense_gap.scoring import ScoreError, read_answers, read_verdicts
from cablesense_gap.verdict import VerdictError, write_verdict

HEADER = "recording,effects,where\n"


def answers_of(tmp_path, text):
    path = tmp_path / "answers.csv"
    path.write_text(text, encoding="utf-8")
    return read_answers(path)


def test_effects_and_places_are_found_however_they_are_written(tmp_path):
    first, second, third = answers_of(
        tmp_path,
        "recording, effects, where, gap_over_floor, form\n"
        "rec_01, payload+base_tilt, , 7.5, lump\n"
        'rec_02.csv,sensor_gain,"cable_3, cable_12",,\n'
        "rec_03,sensor_crosstalk,cable_2_into_cable_5,3,\n",
    )
    assert first.effects == ("base_tilt", "payload")
    assert first.places == frozenset()
    assert (first.gap_over_floor, first.form) == (7.5, "lump")
    assert second.recording == "rec_02"
    assert second.places == {"cable_3", "cable_12"}
    assert second.gap_over_floor is None
    assert third.places == {"cable_2", "cable_5"}


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


def test_answers_that_are_not_there_are_refused(tmp_path):
    with pytest.raises(ScoreError, match="cannot be read"):
        read_answers(tmp_path / "answers.csv")


def test_verdicts_lie_in_folders_or_as_files(tmp_path):
    (tmp_path / "rec_01").mkdir()
    write_verdict(tmp_path / "rec_01" / "verdict.json", verdict_of("none"))
    write_verdict(tmp_path / "rec_02.json", verdict_of("payload"))
    (tmp_path / "notes.json").write_text("{}")
    found = read_verdicts(tmp_path, ["rec_01", "rec_02"])
    assert found["rec_01"].effects == ("none",)
    assert found["rec_02"].effects == ("payload",)
    with pytest.raises(ScoreError, match=r"no verdict on rec_03 and 1 more"):
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
    assert "1 of 2" in table.output
    result = CliRunner().invoke(app, [*command, "--json"])
    figures = json.loads(result.stdout)
    assert figures["exact"]["value"] == 0.5
    assert figures["confusion"]["sensor_lag"] == {"none": 1}
