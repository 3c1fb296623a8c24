"""The score sheet, against counts done by hand."""

from __future__ import annotations

import json

import pytest
from verdict_cases import gap_of, verdict_of

from cablesense_gap.scoring import Answer, ScoreError, as_json, score


def answer(name, effects, *places, **more):
    return Answer(name, tuple(effects.split("+")), frozenset(places), **more)


ANSWERS = (
    answer("a", "payload", "segment_2", gap_over_floor=9.0, form="lump"),
    answer("b", "sensor_gain", "cable_3", gap_over_floor=2.0, form="scale"),
    answer("c", "sensor_gain", "cable_3", "cable_5", gap_over_floor=20.0, form="scale"),
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
    found = score(VERDICTS, ANSWERS)
    counts = {
        name: (getattr(found, name).hits, getattr(found, name).count)
        for name in (
            "exact", "top2", "truth_in_group", "singles_exact", "clear_singles_exact",
            "doubles_both", "doubles_one", "false_alarms", "unknown_recall", "where",
        )
    }  # fmt: skip
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
    assert found.cases == 8
    assert found.wrong == ("b", "d", "g")
    assert found.confusion["base_tilt+payload"] == {"payload": 1, "base_tilt+payload": 1}
    assert found.confusion["none"] == {"none": 1, "unknown": 1}
    assert found.by_effect["sensor_gain"].value == 0.5
    assert found.by_form["lump"].count == 1
    assert set(found.by_form) == {"lump", "scale"}


def test_probabilities_and_removed_gap_are_means_over_the_right_cases():
    found = score(VERDICTS, ANSWERS)
    truth = [0.8, 0.4, 1.0, 0.1, 0.9, 1.0, 0.0, 0.5]
    assert found.mean_probability_on_truth == pytest.approx(sum(truth) / 8)
    stated = [0.8, 0.6, 1.0, 0.7, 0.9, 1.0, 0.5, 0.5]
    right = [1, 0, 1, 0, 1, 1, 0, 1]
    by_hand = sum((p - y) ** 2 for p, y in zip(stated, right, strict=True)) / 8
    assert found.calibration.brier == pytest.approx(by_hand)
    several = [0.2**2, 0.6**2 + 0.6**2, 0, 0.9**2 + 0.7**2 + 0.2**2, 0.1**2, 0, 1 + 0.5**2, 0.5**2]
    assert found.brier_over_candidates == pytest.approx(sum(several) / 8)
    assert found.median_removed_fraction == pytest.approx(0.9)  # of 1.0, 0.9 and 0.8


def test_only_the_kinds_of_places_that_the_answer_names_count():
    said = verdict_of("payload", segments=("segment_2",), cables=("cable_4", "cable_5"))
    for places, right in (
        (("segment_2",), 1),
        (("segment_3",), 0),
        (("segment_2", "joint_2"), 0),
        (("cable_5", "cable_4"), 1),
    ):
        assert score({"a": said}, [answer("a", "payload", *places)]).where.hits == right
    assert score({"a": said}, [answer("a", "payload")]).where.count == 0


def test_a_silent_answer_takes_the_gap_as_the_verdict_measured_it():
    large, small = gap_of(0.51, 0.1), gap_of(0.49, 0.1)
    for gap, count in ((large, 1), (small, 0)):
        found = score({"a": verdict_of("payload", gap=gap)}, [answer("a", "payload")])
        assert found.clear_singles_exact.count == count


def test_the_second_of_top2_is_the_best_beside_the_verdict():
    said = verdict_of("payload", 0.3, others={"base_tilt": 0.5, "none": 0.2})
    for truth, hits in (("payload", 1), ("base_tilt", 1), ("none", 0)):
        assert score({"a": said}, [answer("a", truth)]).top2.hits == hits


def test_without_a_case_there_is_no_figure():
    found = score({"a": verdict_of("none")}, [answer("a", "none")])
    assert found.singles_exact.value is None
    assert found.median_removed_fraction is None
    assert json.loads(json.dumps(as_json(found)))["doubles_both"] == {
        "value": None,
        "ci95": [0.0, 1.0],
        "hits": 0,
        "count": 0,
    }


def test_json_holds_every_figure():
    figures = json.loads(json.dumps(as_json(score(VERDICTS, ANSWERS))))
    assert figures["exact"]["value"] == 5 / 8
    assert figures["confusion"]["payload"] == {"payload": 1}
    assert figures["calibration"]["bins"]
    assert figures["by_effect"]["payload"]["count"] == 1
    assert figures["wrong"] == ["b", "d", "g"]


def test_an_answer_without_a_verdict_is_refused():
    with pytest.raises(ScoreError, match="no verdict on z"):
        score(VERDICTS, [answer("z", "none")])
    with pytest.raises(ScoreError, match="no answers"):
        score(VERDICTS, [])
