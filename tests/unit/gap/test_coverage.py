"""The share of a recording that its reference covers, and what is lacking, in words."""

import numpy as np

from cablesense_gap.coverage import coverage_of
from cablesense_gap.diagnosis.discrepancy import Conditions, ConditionUnits, SmoothColumns
from cablesense_gap.report.text import coverage_sentence, headline
from cablesense_gap.verdict import ReferenceGap
from tests.helpers.verdict_cases import verdict_of

ROWS = 100
UNITS = [
    ConditionUnits(name, "rad", "rad/s", "N·m", "rad/s²")
    for name in ("shoulder", "elbow", "wrist")
]
COURSE = np.tile(np.linspace(-1.0, 1.0, ROWS)[:, None], (1, len(UNITS)))
ELSEWHERE = np.array([5.0, 0.0, 0.0])
KNOWN = SmoothColumns.like(Conditions(COURSE, COURSE, COURSE, COURSE))


def coverage(covered, counts=1.0, **moved):
    """Of readings at the reference's conditions, but for those given."""
    conditions = Conditions(COURSE, COURSE, COURSE, COURSE)._replace(**moved)
    whole = np.broadcast_to(counts, COURSE.shape)
    return coverage_of(covered, whole, conditions, KNOWN, UNITS)


def test_a_channel_lacks_what_leaves_the_reference_s_range_where_it_is_not_covered():
    covered = np.ones(COURSE.shape, dtype=bool)
    covered[:80, 0] = False
    found = coverage(covered, position=COURSE + ELSEWHERE)
    assert list(found.uncovered_channels) == ["shoulder"]
    assert found.by_channel["shoulder"].share == 0.2
    assert found.by_channel["elbow"].share == 1.0
    (position,) = found.by_channel["shoulder"].lacking
    assert position.quantity == "position"
    assert position.reference == (-1.0, 1.0)
    assert position.recorded[0] > 4.0
    assert "shoulder at positions of 4.1 to 5.5 rad" in found.experiment


def test_readings_that_do_not_count_are_not_lacking():
    covered = np.ones(COURSE.shape, dtype=bool)
    covered[:80, 0] = False
    rests = np.ones(COURSE.shape)
    rests[:80, 0] = 0.0
    found = coverage(covered, rests, position=COURSE + 5.0)
    assert not found.uncovered_channels
    assert found.share == 1.0


def test_a_combination_that_is_new_is_named_as_such():
    covered = np.zeros(COURSE.shape, dtype=bool)
    found = coverage(covered)
    assert found.by_channel["wrist"].lacking == ()
    assert "wrist in the poses of this recording" in found.experiment


def test_the_first_line_names_the_channels_that_are_not_covered():
    covered = np.ones(COURSE.shape, dtype=bool)
    covered[:, 0] = False
    found = coverage(covered)
    reference = ReferenceGap(
        recording="healthy",
        before_n=9.0,
        left_n=2.0,
        covered_share=found.share,
        coverage=dict(found.by_channel),
    )
    verdict = verdict_of("cannot_tell", reference=reference)
    assert headline(verdict) == (
        "Cannot tell whether anything changed since the reference, which covers 0 % of shoulder: "
        "record this motion when healthy."
    )
    assert coverage_sentence(verdict).startswith("The reference covers 67 % of the readings")
