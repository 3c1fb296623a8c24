"""The experiment that distinguishes hypotheses, where physics says which one must."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cablesense_gap.experiments import Experiment, next_experiment
from cablesense_gap.protocol import BlockKind, standard_protocol
from cablesense_gap.simulator import Term
from cablesense_sim.replay import reading_variance_n2
from tests.helpers.gap_recordings import LAB

FLOOR_N = float(np.sqrt(reading_variance_n2(LAB.sensors)))
BLOCKS = standard_protocol(LAB)

CREEP = {Term("cable_creep", "arm", "share"): 0.3}
PAYLOAD = {Term("payload", "segment_4", "mass_kg"): 0.4}
SPRING = {Term("joint_elasticity", "joint_2", "stiffness_n_m_rad"): 10.0}
CONTACT = {Term("contact_offset", "segment_3", "offset_m"): 0.03}
GAIN = {Term("sensor_gain", "cable_5", "gain"): 0.08}
OFFSET = {Term("sensor_offset", "cable_5", "offset_n"): 3.0}


def first(kind: BlockKind, said: str = "", segment: int = 0) -> int:
    return next(
        k
        for k, block in enumerate(BLOCKS)
        if block.kind is kind and said in block.does and segment in (0, block.segment)
    )


REST = BLOCKS[first(BlockKind.REST)]
LOADED = tuple(BLOCKS[first(BlockKind.LOAD_CYCLE, "to the left", n)] for n in (3, 4))
HOLD = BLOCKS[first(BlockKind.HOLD)]
SWEEP = BLOCKS[first(BlockKind.SWEEP, "joint_2_yaw")]
FEW = (REST, *LOADED, SWEEP)


@cache
def asked(*rivals: int) -> Experiment:
    every = ({}, PAYLOAD, SPRING, CONTACT, GAIN, OFFSET)
    return next_experiment(LAB, [every[k] for k in rivals], FLOOR_N, FEW)


@pytest.mark.slow
def test_an_effect_is_confirmed_by_the_block_that_excites_it():
    """A joint's spring by its motion; a contact by loads on its segment; an offset at rest."""
    assert [asked(k).block for k in (2, 3, 5)] == [SWEEP.does, LOADED[0].does, REST.does]
    experiment = asked(2)
    assert experiment.text.startswith(f"To confirm it: {SWEEP.does} There joint elasticity must")
    floors = experiment.separation_n / FLOOR_N
    assert f"{floors:.0f} times the noise floor, most at cable" in experiment.text


@pytest.mark.slow
def test_a_block_that_confirms_either_distinguishes_them():
    experiment = asked(2, 3)
    assert experiment.block in (SWEEP.does, LOADED[0].does)
    assert experiment.separation_n > 5.0 * FLOOR_N
    assert experiment.text.startswith("To distinguish joint elasticity from contact offset: ")
    # a gain is distinguished from an offset by loads alone, as constants are fitted to each
    assert asked(4, 5).block in {block.does for block in LOADED}
    assert asked(4, 5).text.endswith("most at cable 5.")


@pytest.mark.slow
def test_the_first_block_is_proposed_that_shows_almost_as_much_as_any():
    """Each block is judged by itself; a rest shows neither of these."""
    for rival in (SPRING, CONTACT):
        alone = [next_experiment(LAB, [rival], FLOOR_N, (block,)) for block in FEW]
        most_n = max(each.separation_n for each in alone)
        first_best = next(each for each in alone if each.separation_n >= 0.9 * most_n)
        assert next_experiment(LAB, [rival], FLOOR_N, FEW) == first_best


@pytest.mark.slow
def test_creep_shows_in_a_long_hold():
    experiment = next_experiment(LAB, [CREEP, PAYLOAD], FLOOR_N, (REST, LOADED[1], HOLD))
    assert experiment.block == HOLD.does


def test_without_an_effect_or_a_simulation_there_is_no_experiment():
    assert next_experiment(LAB, [{}], FLOOR_N) == Experiment("No further experiment is needed.")
    heavy = {Term("payload", "segment_4", "mass_kg"): 500.0}
    assert "can be simulated" in next_experiment(LAB, [heavy], FLOOR_N, LOADED).text
    with pytest.raises(ValueError, match="no explanation is given"):
        next_experiment(LAB, [], FLOOR_N)
