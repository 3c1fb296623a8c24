"""The wall: Hooke with damping, never a pull, and in one look at rest with an elastic arm."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.admittance.wall import Approach, ElasticWall, WallPressing

NORMAL = np.array([0.0, 0.6, 0.8])
POINT = np.array([0.3, 0.0, 0.0])


def wall(stiffness=1e4, damping=0.0):
    return ElasticWall(POINT, NORMAL, stiffness, damping)


@given(st.floats(1.0, 1e6), st.floats(0.0, 0.01), st.floats(-0.05, 0.05))
def test_on_a_rigid_arm_force_is_stiffness_times_penetration(stiffness, advance, aside):
    sideways = aside * np.array([1.0, 0.8, -0.6])
    force = WallPressing(wall(stiffness), 0.0).look(POINT + sideways, advance, 0.01)
    assert force == pytest.approx(stiffness * advance * NORMAL, abs=1e-5)


@given(st.lists(st.floats(-0.01, 0.01), min_size=1), st.floats(0.0, 1e4), st.floats(0.0, 1e-4))
def test_it_never_pulls_and_is_not_felt_from_afar(advances, damping, compliance):
    pressing = WallPressing(wall(damping=damping), compliance)
    for advance in advances:
        before = pressing.force_n
        force = pressing.look(POINT, advance, 0.01)
        assert force @ NORMAL >= 0.0
        if advance <= 0.0 and not before:
            assert not force.any()


def test_damping_adds_while_it_closes_and_takes_away_while_it_opens():
    pressing = WallPressing(wall(1000.0, 50.0), 0.0)
    assert pressing.look(POINT, 0.010, 0.1) @ NORMAL == pytest.approx(10.0 + 5.0)
    assert pressing.look(POINT, 0.010, 0.1) @ NORMAL == pytest.approx(10.0)
    assert pressing.look(POINT, 0.008, 0.1) @ NORMAL == pytest.approx(8.0 - 1.0)
    assert pressing.look(POINT, 0.001, 0.01) @ NORMAL == 0.0


@given(st.floats(100.0, 1e6), st.floats(1e-8, 1e-3), st.floats(1e-4, 0.01))
def test_against_an_elastic_arm_one_look_finds_the_rest(stiffness, compliance, advance):
    """Springs in series: F = advance / (1/k + c), whatever the wall pressed with before."""
    pressing = WallPressing(wall(stiffness), compliance)
    expected = advance / (1.0 / stiffness + compliance)
    for _ in range(3):
        point = POINT + compliance * pressing.force_n * NORMAL
        force = pressing.look(point, advance, 0.0)
        if pressing.force_n:
            assert pressing.force_n == pytest.approx(expected, rel=1e-6)
    assert np.allclose(force, pressing.force_n * NORMAL)


def test_the_wall_lets_go_at_once_when_the_arm_has_left_it():
    pressing = WallPressing(wall(), 1e-5)
    assert pressing.look(POINT, 0.003, 0.01).any()
    assert not pressing.look(POINT + 0.004 * NORMAL, 0.003, 0.01).any()


def test_it_approaches_at_its_speed_stops_and_returns():
    approach = Approach(-0.005, 0.01)
    assert approach.towards(0.003, 0.5) == pytest.approx(0.0)
    assert approach.towards(0.003, 0.5) == pytest.approx(0.003)
    assert approach.towards(0.003, 0.5) == pytest.approx(0.003)
    assert approach.towards(-0.005, 0.1) == pytest.approx(0.002)
