"""Readings that cannot be true are refused; slack cables are not."""

import math

import numpy as np
import pytest

from cablesense_online.samples import ProblemKind, SampleCheck, SampleError

GOOD = [50.0] * 12


def changed(cable, tension):
    return [*GOOD[: cable - 1], tension, *GOOD[cable:]]


@pytest.mark.parametrize("tension", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("cable", [1, 7, 12])
def test_not_finite(cable, tension):
    with pytest.raises(SampleError, match=f"cable_{cable} ") as caught:
        SampleCheck(None, 1.0).check(changed(cable, tension))
    assert caught.value.kind is ProblemKind.NOT_FINITE


@pytest.mark.parametrize("tension", [-21.0, 1e5, 1e308])
def test_implausible_without_a_range(tension):
    with pytest.raises(SampleError) as caught:
        SampleCheck(None, 1.0).check(changed(4, tension))
    assert caught.value.kind is ProblemKind.IMPLAUSIBLE


@pytest.mark.parametrize("tension", [0.0, 500.0, 501.0, -1.0])
def test_saturated_at_the_ends_of_the_range(tension):
    with pytest.raises(SampleError, match=r"0 … 500 N; unload the arm") as caught:
        SampleCheck((0.0, 500.0), 1.0).check(changed(4, tension))
    assert caught.value.kind is ProblemKind.SATURATED


def test_slack_cables_are_noted_and_forgotten():
    check = SampleCheck(None, 1.0)
    check.check(changed(3, 0.2))
    assert check.slack == (3,)
    check.check(np.array(GOOD))
    assert check.slack == ()
