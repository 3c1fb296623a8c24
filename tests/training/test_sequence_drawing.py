"""Sequences: the arm's statics at rest, something else in motion and under friction."""

from dataclasses import replace

import numpy as np
import pytest

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_training.data.dataset import contact_forces_n
from cablesense_training.data.motion_protocol import MotionProtocol
from cablesense_training.data.sequences import draw_sequences
from cablesense_training.evaluation.metrics import unsettled

pytestmark = pytest.mark.slow

CDSM, FRICTION = open_arm("cdsm"), open_arm("cdsm_friction")
SHORT = MotionProtocol(sequences=2, duration_s=4.0, noise=False)


@pytest.fixture(scope="module")
def in_time():
    return draw_sequences(CDSM, SHORT, seed=1)


@pytest.fixture(scope="module")
def with_friction():
    return draw_sequences(FRICTION, replace(SHORT, duration_s=6.0), seed=1)


def _statics_n(sequences):
    """(S, T, M) differences that an arm without friction has at rest in every set-point."""
    mechanism = mechanism_of(sequences.arm)
    differences = []
    for command, segment, angle, magnitude in zip(
        sequences.joint_command_rad,
        sequences.segment,
        sequences.angle_deg,
        sequences.magnitude_n,
        strict=True,
    ):
        here = segment[:, None] == np.arange(1, mechanism.segment_count + 1)
        forces = contact_forces_n(
            mechanism, command, here * angle[:, None], here * magnitude[:, None]
        )
        loaded = solve_equilibrium(mechanism, command, forces).tensions_n
        differences.append(loaded - solve_equilibrium(mechanism, command).tensions_n)
    return np.stack(differences)


def test_at_rest_and_under_a_steady_load_tensions_are_those_of_statics(in_time):
    off = np.abs(in_time.tension_difference_n - _statics_n(in_time)).max(axis=-1)
    force = in_time.magnitude_n
    steady = ~unsettled(in_time)
    steady[:, 10:] &= np.abs(force[:, 10:] - force[:, :-10]) < 1e-9
    steady[:, :10] = False
    assert steady.sum() > 20
    assert np.quantile(off[steady], 0.95) < 0.05


def test_motion_adds_inertia_that_statics_does_not_know(in_time):
    free = unsettled(in_time) & (in_time.segment == 0)
    assert free.any()
    assert np.abs(in_time.tension_difference_n[free]).max() > 0.5


def test_friction_leaves_a_difference_at_rest_that_depends_on_the_past(with_friction):
    off = np.abs(with_friction.tension_difference_n - _statics_n(with_friction)).max(axis=-1)
    later = ~unsettled(with_friction)
    later[:, :50] = False
    assert off[:, 0].max() < 1e-6  # the tare was just taken there
    assert later.any()
    assert np.median(off[later]) > 0.5


def test_workers_and_seed_change_nothing_and_everything():
    protocol = replace(SHORT, sequences=33, duration_s=0.1)
    one, two = (draw_sequences(FRICTION, protocol, 7, workers=workers) for workers in (1, 2))
    np.testing.assert_array_equal(one.tension_difference_n, two.tension_difference_n)
    other = draw_sequences(FRICTION, protocol, 8)
    assert not np.array_equal(one.joint_command_rad, other.joint_command_rad)


def test_progress_counts_what_is_done():
    done = []
    draw_sequences(FRICTION, replace(SHORT, sequences=33, duration_s=0.04), 0, on_done=done.append)
    assert done == [32, 1]
