"""A constant that is switched off is neutral where it is used, and then has its value again."""

import pytest
import search_ablation
from search_ablation import CONSTANTS, OF_A_REFERENCE, OF_HISTORY

from cablesense_gap.diagnosis import nuisance, problem


@pytest.mark.parametrize(
    "constant", [*CONSTANTS, *OF_HISTORY, *OF_A_REFERENCE], ids=lambda one: one.label
)
def test_a_constant_is_off_in_the_block_alone(constant):
    usual = constant.value
    with constant.off():
        assert constant.value == constant.neutral
        assert constant.value != usual
    assert constant.value == usual


def test_a_constant_that_another_module_imports_is_off_there_too():
    (resolution,) = (each for each in CONSTANTS if each.name == "RESOLUTION")
    with resolution.off():
        assert problem.RESOLUTION == nuisance.RESOLUTION == resolution.neutral
    assert problem.RESOLUTION == nuisance.RESOLUTION != resolution.neutral


def test_names_are_right_false_or_failed():
    truths = [("payload",), ("none",), ("payload", "sensor_gain")]
    outcomes = [
        {"named": name, "probability": 0.9, "variants": 10, "seconds": 1.0}
        for name in ("payload", "sensor_offset", "failed: ValueError")
    ]
    sums = search_ablation._sums(truths, outcomes, outcomes)
    assert (sums["right_names"], sums["false_names"]) == (1, 1)
    assert (sums["exact"], sums["failed"], sums["moved"]) == (1, 1, 0)
