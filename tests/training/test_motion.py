"""Motion and contacts are drawn, and tensions simulated along them."""

from dataclasses import replace

import numpy as np
import pytest

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_training.data.dataset import contact_forces_n
from cablesense_training.data.sequences import (
    STEP_S,
    MotionProtocol,
    draw_sequences,
    drawn_contacts,
    drawn_motion,
)
from cablesense_training.errors import DatasetError
from cablesense_training.evaluation.metrics import unsettled

PROTOCOL = MotionProtocol(duration_s=12.0)


@pytest.fixture(scope="module")
def motion():
    return drawn_motion(PROTOCOL, 8, np.random.default_rng(3))


def test_it_stays_within_the_range_but_for_a_little_overshoot(motion):
    assert np.abs(np.rad2deg(motion.angle_rad)).max() < 1.1 * PROTOCOL.pose_range_deg
    assert np.abs(np.rad2deg(motion.speed_rad_s)).max() < 1.3 * PROTOCOL.joint_speed_deg_s


def test_speeds_are_those_of_the_fine_course(motion):
    fine = motion.fine_rad.reshape(-1, 8)
    inner = motion.fine_rad.shape[1]
    speed = np.gradient(fine, STEP_S, axis=0)[inner - 1 :: inner]
    moved = np.abs(speed - motion.speed_rad_s)[:-1]
    assert np.quantile(moved, 0.99) < 0.02
    np.testing.assert_array_equal(motion.angle_rad, fine[inner - 1 :: inner])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("sequences", 0),
        ("duration_s", float("nan")),
        ("tick_s", 0.0),
        ("pose_range_deg", 90.0),
        ("joint_speed_deg_s", float("inf")),
        ("force_high_n", -1.0),
        ("tare_samples", 0),
    ],
)
def test_a_value_out_of_range_is_refused(name, value):
    with pytest.raises(DatasetError, match=rf"{name} = .*: must be "):
        MotionProtocol(**{name: value})


CONTACTS = MotionProtocol(duration_s=200.0, force_high_n=80.0)


def test_free_ticks_have_no_force_and_contacts_stay_within_the_range():
    contact = drawn_contacts(CONTACTS, 4, np.random.default_rng(0))
    free = contact.segment == 0
    assert 0.2 < free.mean() < 0.8
    assert (contact.magnitude_n[free] == 0.0).all()
    assert (contact.magnitude_n >= 0.0).all()
    assert 40.0 < contact.magnitude_n.max() <= 80.0
    assert set(contact.segment) == {0, 1, 2, 3, 4}
    assert ((contact.angle_deg >= 0.0) & (contact.angle_deg < 360.0)).all()


pytestmark = pytest.mark.slow

CDSM, FRICTION = open_arm("cdsm"), open_arm("cdsm_friction")
SHORT = MotionProtocol(sequences=2, duration_s=3.0, noise=False)


@pytest.fixture(scope="module")
def in_time():
    return draw_sequences(CDSM, SHORT, seed=1)


@pytest.fixture(scope="module")
def with_friction():
    return draw_sequences(FRICTION, replace(SHORT, duration_s=5.0), seed=1)


def _statics_n(drawn):
    """(S, T, M) differences that an arm without friction has at rest in every set-point."""
    mechanism, command = mechanism_of(drawn.arm), drawn.joint_command_rad
    here = drawn.segment[..., None] == np.arange(1, mechanism.segment_count + 1)
    angles, magnitudes = here * drawn.angle_deg[..., None], here * drawn.magnitude_n[..., None]
    forces = contact_forces_n(mechanism, command, angles, magnitudes)
    unloaded = solve_equilibrium(mechanism, command).tensions_n
    return solve_equilibrium(mechanism, command, forces).tensions_n - unloaded


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


def test_the_seed_alone_decides_what_is_drawn():
    protocol = replace(SHORT, duration_s=0.1)
    one, again, other = (draw_sequences(FRICTION, protocol, seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one.tension_difference_n, again.tension_difference_n)
    assert not np.array_equal(one.joint_command_rad, other.joint_command_rad)
