"""A tiny data set: read by the recordings' own reader, without answers beside the recordings."""

from __future__ import annotations

import sys

import data_set
import pytest

from cablesense_gap.scoring import read_answers
from cablesense_recording.reading import read_recording
from cablesense_sim.arm import load_arm


@pytest.mark.slow
def test_a_tiny_one_is_made_and_read_and_its_answers_lie_apart(tmp_path, monkeypatch):
    kinds = {"nominal": ["sensor_offset"], "built": ["none"], "friction": ["none"]}
    monkeypatch.setattr(data_set, "kinds_of", lambda *_: kinds)  # friction takes long
    out = tmp_path / "set"
    command = ["data_set.py", "--out", str(out), "--count", "1", "--workers", "1"]
    monkeypatch.setattr(sys, "argv", command)
    data_set.main()
    for group in ("nominal", "built", "friction"):
        answers = read_answers(out / f"answers/{group}.csv")
        assert ["+".join(answer.effects) for answer in answers] == kinds[group]
        arm = load_arm(out / group / "arm.yaml")
        for answer in answers:
            recording = read_recording(out / group / f"{answer.recording}.csv", arm)
            assert len(recording) > 1000
        written = {path.name for path in (out / group).iterdir()}
        assert written == {"arm.yaml", *(f"{answer.recording}.csv" for answer in answers)}
    card = (out / "README.md").read_text(encoding="utf-8")
    assert "Apache License 2.0" in card
    assert "tension_12_n" in card
    assert "$" not in card


def test_a_group_hides_friction_only_where_it_says_so():
    kinds = data_set.kinds_of(20, seed=1)
    slow = set(data_set.FRICTION)
    for group in ("nominal", "built"):
        assert len(kinds[group]) == 20
        assert kinds[group].count("none") == kinds[group].count("unknown") == 5
        assert not slow & {effect for kind in kinds[group] for effect in kind.split("+")}
    assert set(kinds["friction"]) == slow


def measured(hits):
    share = {"hits": hits, "count": 8}
    keys = ("exact", "where", "false_alarms", "unknown_recall")
    return {**dict.fromkeys(keys, share), "median_removed_fraction": 0.97}


def test_the_card_states_the_figures_of_that_very_set():
    counts = {"nominal": 8, "built": 8, "friction": 3}
    groups = {"nominal": measured(7), "built": measured(5)}
    scores = {"seed": 6120, "count": 8, "command": "python one.py", "groups": groups}
    text = data_set.card(counts, 6120, scores)
    assert "| effects right | 7 of 8 | 5 of 8 |" in text
    assert "| 97% | 97% |" in text
    assert "No baseline was measured for friction." in text
    other = data_set.card(counts, 6121, scores)
    assert "No baseline was measured for nominal, built, friction." in other
    assert "7 of 8" not in other
