"""The protocol to record: within what the arm bears, and rich enough to tell effects apart."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from cablesense_gap.protocol import (
    STRONGEST_N,
    BlockKind,
    bearable_load_n,
    rows_of,
    standard_protocol,
)
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.touch import touched_places

ARMS = {name: open_arm(name) for name in ("cdsm_lab", "cdsm_table2")}
LAB = ARMS["cdsm_lab"]
BLOCKS = standard_protocol(LAB)


def tensions_of(rows, mechanism, **changes):
    """Of rows with loads at their places, of which a change of `contact_m` moves all."""
    changed = replace(mechanism, **changes)
    moved_m = changed.contact_m - mechanism.contact_m
    places_m = np.nan_to_num(rows.course.places_m, nan=0.0) + moved_m
    touched = replace(changed, contact_m=places_m)
    return solve_equilibrium(touched, rows.command_rad, rows.forces_n).tensions_n


def in_kind(arm, kind):
    """The protocol's rows at 2 Hz, and which of them are of blocks of a kind."""
    blocks = standard_protocol(arm)
    rows = rows_of(blocks, 2.0)
    return rows, np.isin(rows.trial, [i for i, block in enumerate(blocks) if block.kind is kind])


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_no_cable_goes_slack_but_where_it_is_meant_to(arm):
    rows, slackening = in_kind(arm, BlockKind.SLACKENING)
    tensions = tensions_of(rows, mechanism_of(arm))
    assert tensions[~slackening].min() >= 0.1 * arm.cables.pretension_n
    slack = set(rows.trial[(tensions <= 0.0).any(axis=1)])
    assert len(slack) >= 0.8 * len(set(rows.trial[slackening]))
    assert (tensions <= 0.0).any(axis=0).sum() >= 4
    assert np.linalg.norm(rows.load_n, axis=1).max() <= STRONGEST_N + 1e-9


def test_blocks_follow_on_without_a_jump_of_the_command():
    for before, after in pairwise(BLOCKS):
        np.testing.assert_allclose(before.commands_rad[-1], after.commands_rad[0], atol=1e-12)
        assert not before.loads_n[-1].any()
    speed = np.abs(np.diff(rows_of(BLOCKS, 100.0).command_rad, axis=0)) * 100.0
    assert np.rad2deg(speed.max()) < 20.0  # the speed of the simulated arm


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_every_segment_is_loaded_at_three_places_within_reach(arm):
    blocks = [b for b in standard_protocol(arm) if b.kind is BlockKind.LOAD_CYCLE]
    touched_m = touched_places(arm).touched_m
    for n in range(1, arm.segment_count + 1):
        places = sorted({b.at_m for b in blocks if b.segment == n})
        assert len(places) == 3
        assert touched_m[n - 1, 0] < places[0] < places[1] < places[2] < touched_m[n - 1, 1]
        assert places[1] == mechanism_of(arm).contact_m[n - 1]
    rows = rows_of(blocks, 2.0)
    np.testing.assert_array_equal(np.isfinite(rows.load_at_m), rows.load_segment > 0)


def test_a_bearable_load_is_the_strongest_that_leaves_all_taut():
    down = np.array([0.0, 0.0, -1.0])
    mechanism = mechanism_of(LAB)
    found = bearable_load_n(LAB, np.zeros(8), 4, down, float(mechanism.contact_m[3]))
    forces = np.zeros((2, 4, 3))
    forces[:, 3] = np.outer([found, found + 2.0], down)
    least = solve_equilibrium(mechanism, np.zeros(8), forces).tensions_n.min(axis=1)
    assert least[0] >= 5.0 > least[1]


@pytest.mark.slow
def test_the_sensors_range_bounds_the_load():
    sensors = LAB.sensors.model_copy(update={"range_n": (0.0, 110.0)})
    short = LAB.model_copy(update={"sensors": sensors})
    rows = rows_of(standard_protocol(short), 2.0)
    assert tensions_of(rows, mechanism_of(short)).max() <= 0.9 * 110.0 + 1e-9
