"""Residuals with a planted cause: the part that holds it stands out, and the numbers add up.

Regimes are named where a planted gap is, and only there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arm_variants import five_by_four, variant
from gap_recordings import CYCLE, LAB, small_recording
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.residuals import (
    EVERYWHERE,
    LOADED,
    LOOP,
    MODES,
    REGIMES,
    SET,
    TRIAL,
    decompose,
    load_branch,
    loop_n,
    regimes,
    row_groups,
    segment_modes_n,
)

SMALL = small_recording()
FLOOR_N = 0.1
SHAPE = SMALL.tensions_n.shape


def noise(seed=1):
    return np.random.default_rng(seed).normal(0.0, FLOOR_N, SHAPE)


def by_name(decomposition, group):
    return {part.member: part for part in decomposition.of_group(group)}


def largest(decomposition, group):
    return max(decomposition.of_group(group), key=lambda part: part.rms_n).member


def test_noise_alone_is_at_the_floor_everywhere():
    found = decompose(SMALL, noise(), FLOOR_N, LAB)
    for part in found.parts:
        if part.group != LOOP and part.count > 30:
            assert part.over_floor == pytest.approx(1.0, abs=0.35), part
            assert part.systematic_share < 0.3, part
    assert found.rms_n == pytest.approx(FLOOR_N, rel=0.03)


def test_an_offset_of_one_cable_is_systematic_and_in_that_cable():
    residual = noise()
    residual[:, 6] -= 2.0
    found = decompose(SMALL, residual, FLOOR_N, LAB)
    assert largest(found, "cable") == "cable_7"
    part = by_name(found, "cable")["cable_7"]
    assert part.mean_n == pytest.approx(-2.0, abs=0.03)
    assert part.systematic_share > 0.99
    assert part.over_floor == pytest.approx(20.0, rel=0.02)


def test_a_pull_on_all_cables_of_a_set_is_common_mode():
    residual = noise()
    residual[:, 3:6] += 1.0
    modes = by_name(decompose(SMALL, residual, FLOOR_N, LAB), SET)
    assert modes["segment_2, common mode"].mean_n == pytest.approx(3**0.5, abs=0.03)
    for name in ("segment_2, bending, y", "segment_2, bending, z", "segment_1, common mode"):
        assert modes[name].over_floor < 1.3


FIVE = variant({"cables.per_segment": 5, "cables.angle_deg.per_cable": -72})


@pytest.mark.parametrize("arm", [LAB, five_by_four(), FIVE])
def test_modes_keep_noise_and_squares(arm):
    """Parseval: nothing of a residual is lost, however many cables a segment has."""
    residual = np.random.default_rng(2).normal(size=(4000, arm.cable_count))
    modes = segment_modes_n(residual, arm)
    assert modes.shape == (4000, arm.segment_count, arm.cables.per_segment)
    np.testing.assert_allclose((modes**2).sum(axis=(1, 2)), (residual**2).sum(axis=1), rtol=1e-12)
    np.testing.assert_allclose(modes.std(axis=0), 1.0, atol=0.06)


def test_two_pairs_of_cables_against_each_other_are_self_stress():
    """Neither compressed nor bent; of three cables there is none."""
    arm, size = five_by_four(), len(SMALL)
    residual = np.zeros((size, 20))
    residual[:, 4:8] = [1.0, -1.0, 1.0, -1.0]
    recording = replace(
        SMALL,
        tensions_n=np.full((size, 20), 50.0),
        command_rad=np.pad(SMALL.command_rad, ((0, 0), (0, 2))),
    )
    parts = by_name(decompose(recording, residual, FLOOR_N, arm), SET)
    assert abs(parts["segment_2, self-stress"].rms_n) == pytest.approx(2.0)
    for name in MODES[:3]:
        assert parts[f"segment_2, {name}"].rms_n == pytest.approx(0.0, abs=1e-9)
    whole = sum(part.rms_n**2 for part in parts.values())
    assert whole == pytest.approx((residual[0] ** 2).sum())
    three = decompose(SMALL, noise(), FLOOR_N, LAB).of_group(SET)
    assert not any("self-stress" in part.member for part in three)


def test_a_residual_towards_z_of_the_holes_is_the_z_part():
    angles = LAB.cables.angle_deg
    for n in range(4):
        hole = np.deg2rad(angles.first + angles.per_segment * n + angles.per_cable * np.arange(3))
        residual = np.zeros((1, 12))
        residual[0, 3 * n : 3 * n + 3] = np.cos(hole)
        modes = segment_modes_n(residual, LAB)[0, n]
        assert modes[MODES.index("bending, z")] == pytest.approx(1.5**0.5)
        np.testing.assert_allclose(modes[:2], 0.0, atol=1e-12)


def test_every_row_is_in_one_member_of_each_partition():
    masks: dict[str, list[np.ndarray]] = {}
    for group, _, rows in row_groups(SMALL):
        masks.setdefault(group, []).append(rows)
    assert set(REGIMES) | {TRIAL} == set(masks)
    for group, listed in masks.items():
        count = np.sum(listed, axis=0)
        assert count.max() == 1, group
        if group in (LOADED, "pose", "rest and motion", "time", TRIAL):
            assert count.min() == 1, group


def test_a_gap_at_one_loaded_segment_is_found_there():
    residual = noise()
    residual[SMALL.load_segment == 3] += 3.0
    found = decompose(SMALL, residual, FLOOR_N, LAB)
    assert largest(found, LOADED) == "segment_3"
    assert by_name(found, LOADED)["segment_3"].over_floor == pytest.approx(30.0, rel=0.03)


def test_branches_follow_the_load():
    branch = load_branch(SMALL)
    cycle = branch[SMALL.trial == 1]
    np.testing.assert_array_equal(cycle, np.repeat([0, 1, 1, 1, 1, 2, 2, 2, 3], len(CYCLE) // 9))
    assert (branch[SMALL.trial == 0] == -1).all()
    assert (branch[SMALL.trial == 9] == -1).all()


@given(seed=st.integers(0, 1000), jitter=st.floats(0.0, 0.02))
@settings(deadline=None, max_examples=25)
def test_branches_do_not_mind_the_jitter_of_a_load_cell(seed, jitter):
    rng = np.random.default_rng(seed)
    size = np.abs(SMALL.load_n[:, 2])
    size = np.where(size > 0.0, size + 40.0 * jitter * rng.uniform(-1.0, 1.0, len(size)), 0.0)
    shaken = replace(SMALL, load_n=np.outer(size, [0.0, 0.0, -1.0]))
    np.testing.assert_array_equal(load_branch(shaken), load_branch(SMALL))


def test_hysteresis_shows_as_a_loop_and_what_depends_on_the_load_does_not():
    branch = load_branch(SMALL)
    sides = np.select([branch == 1, branch == 2], [1.0, -1.0])[:, None] * np.ones(12)
    found = loop_n(SMALL, 0.7 * sides)
    level_count = 8 * 4  # trials, and levels of each, of which the rest's differs by nothing
    assert found.shape == (level_count, 12)
    assert np.abs(found).max() == pytest.approx(0.7)
    elastic = np.linalg.norm(SMALL.load_n, axis=1)[:, None] * np.ones(12)
    np.testing.assert_allclose(loop_n(SMALL, elastic), 0.0, atol=1e-12)
    loops = decompose(SMALL, 0.7 * sides, FLOOR_N, LAB).of_group(LOOP)
    assert loops[0].over_floor > 5.0


def test_missing_numbers_are_left_out():
    residual = noise()
    residual[:, 6] += 2.0
    whole = decompose(SMALL, residual, FLOOR_N, LAB)
    residual[::3, 4] = np.nan
    residual[:, 0] = np.nan
    found = decompose(SMALL, residual, FLOOR_N, LAB)
    assert by_name(found, "cable")["cable_7"] == by_name(whole, "cable")["cable_7"]
    assert "cable_1" not in by_name(found, "cable")
    assert by_name(found, "cable")["cable_5"].count < len(SMALL)
    with pytest.raises(ValueError, match="no number"):
        decompose(SMALL, np.full(SHAPE, np.nan), FLOOR_N, LAB)


def test_a_residual_of_another_recording_is_refused():
    with pytest.raises(ValueError, match="residual is"):
        decompose(SMALL, np.zeros((3, 12)), FLOOR_N, LAB)


def test_a_recording_without_a_load_has_no_load_parts():
    quiet = SMALL.rows(SMALL.trial == 0)
    found = decompose(quiet, np.ones((20, 12)), FLOOR_N, LAB)
    assert found.of_group(LOOP) == ()
    assert [part.member for part in found.of_group(LOADED)] == ["no load"]


ROWS = {(group, member): rows for group, member, rows in row_groups(SMALL)}


def found_for(planted):
    noise = np.random.default_rng(4).normal(0.0, FLOOR_N, SMALL.tensions_n.shape)
    return regimes(decompose(SMALL, noise + planted, FLOOR_N, LAB))


def test_noise_has_no_regime():
    assert found_for(0.0) == []


def test_an_offset_is_everywhere():
    assert found_for(np.eye(12)[3]) == [EVERYWHERE]


@pytest.mark.parametrize(
    ("group", "member", "words"),
    [
        ("loaded segment", "segment_2", "load on segment 2"),
        ("pose", "bent", "bent poses"),
        ("joint bent most", "joint_2", "joint 2 bent most"),
        ("load level", "above 27 N", "loads above 27 N"),
        ("rest and motion", "moving", "moving"),
        ("time", "late", "late in the recording"),
    ],
)
def test_the_regime_of_a_planted_gap_is_named(group, member, words):
    rows = ROWS[group, member]
    assert words in found_for(np.where(rows[:, None], 1.0, 0.0))


def test_friction_is_named_as_loading_against_unloading():
    branch = load_branch(SMALL)
    assert "loading against unloading" in found_for(
        np.select([branch == 1, branch == 2], [0.5, -0.5])[:, None]
    )


def test_the_largest_is_named_first():
    planted = np.where(ROWS["loaded segment", "segment_1"], 1.8, 0.0)
    planted += np.where(ROWS["rest and motion", "moving"], 2.5, 0.0)
    found = found_for(planted[:, None])
    assert found.index("moving") < found.index("load on segment 1")
