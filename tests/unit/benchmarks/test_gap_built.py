"""What the arms of the set of built arms hide."""

from __future__ import annotations

from argparse import Namespace

import pytest
from blind_sets import EffectCounts
from gap_built import _kinds

from cablesense_plants.arm.listed import LISTED
from cablesense_plants.cases import NONE


def drawn(count: int, effects: EffectCounts | None = None) -> list[str]:
    return _kinds(Namespace(seed=1, count=count, effects=effects))


@pytest.mark.parametrize("count", [1, 8, 60])
def test_half_of_the_arms_hide_nothing_however_many_there_are(count):
    kinds = drawn(count)
    assert len(kinds) == count
    assert set(kinds[::2]) == {NONE}
    assert set(kinds[1::2]) <= set(LISTED)


def test_no_effect_comes_twice_before_all_have_come_once():
    hidden = drawn(60)[1::2]
    kinds = len(set(hidden))
    assert len(set(hidden[:kinds])) == kinds


def test_several_effects_of_an_arm_differ():
    for kind in drawn(20, effects=EffectCounts(3, 5)):
        names = kind.split("+")
        assert 3 <= len(names) <= 5
        assert len(set(names)) == len(names)
