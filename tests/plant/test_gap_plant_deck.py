"""Which kinds of cases a set has."""

from collections import Counter

import numpy as np
import pytest

from cablesense_gap.plant.case import draw_kinds
from cablesense_gap.plant.listed import LISTED
from cablesense_gap.plant.unlisted import UNLISTED


@pytest.mark.parametrize("count", [1, 2, 5, 14, 60, 97, 300])
def test_a_fifth_hides_nothing_and_a_fifth_what_nobody_listed(count: int) -> None:
    kinds = draw_kinds(np.random.default_rng(count), count)
    assert len(kinds) == count
    if count < 5:
        return
    assert kinds.count("none") >= 0.2 * count
    assert sum(kind in UNLISTED for kind in kinds) >= 0.2 * count
    doubles = [kind for kind in kinds if "+" in kind]
    assert len(doubles) == round(0.12 * count)
    for kind in doubles:
        first, second = kind.split("+")
        assert first < second
        assert {first, second} <= set(LISTED)


def test_sixty_cases_have_every_name() -> None:
    for seed in range(5):
        kinds = draw_kinds(np.random.default_rng(seed), 60)
        singles = Counter(kind for kind in kinds if kind in LISTED)
        assert set(singles) == set(LISTED)
        assert max(singles.values()) <= 2


def test_the_same_seed_deals_the_same() -> None:
    deals = [draw_kinds(np.random.default_rng(seed), 40) for seed in (1, 1, 2)]
    assert deals[0] == deals[1] != deals[2]


def test_only_what_is_asked_for() -> None:
    only = ["payload", "none"]
    assert draw_kinds(np.random.default_rng(0), 3, only) == ["payload", "none", "payload"]
