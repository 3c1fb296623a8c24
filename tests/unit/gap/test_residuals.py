"""Residuals with a planted cause: the part that holds it stands out, and the numbers add up."""

from __future__ import annotations

import numpy as np
import pytest

from cablesense_gap.residuals import (
    EVERYWHERE,
    LOAD_PLACE,
    SET,
    decompose,
    load_branch,
    loop_n,
    regimes,
    row_groups,
)
from tests.helpers.gap_recordings import LAB, PLACES_M, placed_recording, small_recording

SMALL = small_recording()
FLOOR_N = 0.1
SHAPE = SMALL.tensions_n.shape
NOISE = np.random.default_rng(1).normal(0.0, FLOOR_N, SHAPE)
ROWS = {(group, member): rows for group, member, rows in row_groups(SMALL, LAB)}
PLACED = placed_recording()
BRANCH = load_branch(SMALL)
SIDES = np.select([BRANCH == 1, BRANCH == 2], [1.0, -1.0])[:, None] * np.ones(12)


def parts(planted, group):
    parts_found = decompose(SMALL, NOISE + planted, FLOOR_N, LAB)
    return {part.member: part for part in parts_found.of_group(group)}


def test_an_offset_of_one_cable_is_systematic_and_in_that_cable():
    share = parts(-2.0 * np.eye(12)[6], "cable")
    assert max(share, key=lambda name: share[name].rms_n) == "cable_7"
    part = share["cable_7"]
    assert part.mean_n == pytest.approx(-2.0, abs=0.03)
    assert part.systematic_share > 0.99
    assert part.over_floor == pytest.approx(20.0, rel=0.02)


def test_a_pull_on_all_cables_of_a_segment_is_common_mode():
    modes = parts(np.eye(12)[3:6].sum(0), SET)
    assert modes["segment_2, common mode"].mean_n == pytest.approx(3**0.5, abs=0.03)
    for name in ("segment_2, bending, y", "segment_2, bending, z", "segment_1, common mode"):
        assert modes[name].over_floor < 1.3
    assert not any("self-stress" in name for name in modes)  # of three cables there is none


def test_hysteresis_shows_as_a_loop_and_an_elastic_residual_does_not():
    loop = loop_n(SMALL, 0.7 * SIDES)
    assert loop.shape == (8 * 4, 12)  # trials, and levels of each; without a load it is zero
    assert np.abs(loop).max() == pytest.approx(0.7)
    elastic = np.linalg.norm(SMALL.load_n, axis=1)[:, None] * np.ones(12)
    np.testing.assert_allclose(loop_n(SMALL, elastic), 0.0, atol=1e-12)


def regimes_of(planted):
    return regimes(decompose(SMALL, NOISE + planted, FLOOR_N, LAB))


@pytest.mark.parametrize(
    ("planted", "named"),
    [
        (0.0, []),
        (np.eye(12)[3], [EVERYWHERE]),
        (0.5 * SIDES, ["loading against unloading"]),
        (("loaded segment", "segment_2"), ["load on segment 2"]),
        (("pose", "bent"), ["bent poses"]),
        (("joint bent most", "joint_2"), ["joint 2 bent most"]),
        (("load level", "above 27 N"), ["loads above 27 N"]),
        (("rest and motion", "moving"), ["moving"]),
        (("time", "late"), ["late in the recording"]),
    ],
    ids=str,
)
def test_the_regime_of_a_planted_gap_is_named(planted, named):
    regime = regimes_of(1.0 * ROWS[planted][:, None] if isinstance(planted, tuple) else planted)
    assert set(named) <= set(regime)
    assert bool(named) == bool(regime)


def test_a_gap_of_loads_far_from_the_joint_is_named_where_places_are_stated():
    far = PLACED.load_at_m == PLACES_M[2]
    named_regimes = regimes(decompose(PLACED, NOISE + far[:, None], FLOOR_N, LAB))
    assert "loads far from the joint" in named_regimes
    places = [rows for group, _, rows in row_groups(PLACED, LAB) if group == LOAD_PLACE]
    np.testing.assert_array_equal(np.sum(places, axis=0), PLACED.load_segment > 0)
