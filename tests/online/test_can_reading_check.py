"""Single readings: what lies within the range can be true, nothing else."""

from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.can.decoder import reading_fault
from cablesense_online.can.faults import FaultKind

RANGE_N = (-50.0, 3276.0)


@given(st.floats(*RANGE_N, exclude_min=True, exclude_max=True))
def test_a_reading_within_the_range_can_be_true(tension_n):
    assert reading_fault(tension_n, RANGE_N) is None


@pytest.mark.parametrize(
    ("tension_n", "fault"),
    [
        (3276.0, FaultKind.OVER_RANGE),
        (1e9, FaultKind.OVER_RANGE),
        (-50.0, FaultKind.UNDER_RANGE),
        (nan, FaultKind.NOT_FINITE),
        (inf, FaultKind.NOT_FINITE),
        (-inf, FaultKind.NOT_FINITE),
    ],
)
def test_a_reading_at_an_end_or_beyond_is_named(tension_n, fault):
    assert reading_fault(tension_n, RANGE_N) is fault
