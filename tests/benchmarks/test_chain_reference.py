"""Two references of cables over guides: closed forms, work, symmetry, one beside the other."""

from collections.abc import Callable

import numpy as np
import pytest
from friction_law import CableCourse, random_history, searched, tensions_by_law, timed
from hypothesis import given, settings
from hypothesis import strategies as st

Way = Callable[..., CableCourse]

K = np.array([2e5, 5e5, 3e5])
GRIP = np.array([0.3, 0.2])
EVEN = 50.0 / K
WAYS = pytest.mark.parametrize(("way", "close"), [(searched, 1e-9), (timed, 0.01)])


def pulled(amount_m: np.ndarray, piece: int, pieces: int = 3) -> np.ndarray:
    """Stretch of an even cable of which one piece lengthens."""
    return 50.0 / K[:pieces] + np.outer(amount_m, np.eye(pieces)[piece])


@WAYS
def test_one_guide_holds_back_e_to_the_grip_either_way(way: Way, close: float) -> None:
    stretch = pulled(np.array([0.0, 2e-4, 0.0]), 0, 2)
    tension = way(K[:2], GRIP[:1], stretch).tension_n
    np.testing.assert_allclose(tension[1, 0] / tension[1, 1], np.exp(0.3), rtol=close)
    np.testing.assert_allclose(tension[2, 0] / tension[2, 1], np.exp(-0.3), rtol=close)


@WAYS
def test_two_guides_hold_back_the_product(way: Way, close: float) -> None:
    tension = way(K, GRIP, pulled(np.array([0.0, 5e-4, -1e-4]), 0)).tension_n
    np.testing.assert_allclose(tension[1, 0] / tension[1, 2], np.exp(0.5), rtol=close)
    np.testing.assert_allclose(tension[2, 0] / tension[2, 2], np.exp(-0.5), rtol=close)


@WAYS
def test_a_piece_behind_a_guide_that_sticks_keeps_its_tension(way: Way, close: float) -> None:
    """The far end is pulled and let go: nothing has passed while less than e^grip comes off."""
    there_and_back = np.array([0.0, 1e-4, 0.9e-4, 0.8e-4])
    course = way(K, GRIP, pulled(there_and_back, 2))
    np.testing.assert_allclose(course.tension_n[2:, 0], course.tension_n[1, 0], rtol=close)
    assert np.ptp(course.tension_n[1:, 2]) > 5.0


@WAYS
def test_without_friction_one_tension_follows_the_whole_stretch(way: Way, close: float) -> None:
    rng = np.random.default_rng(0)
    stretch = EVEN + rng.normal(scale=3e-5, size=(4, 3))
    stretch[0] = EVEN
    tension = way(K, 0.0 * GRIP, stretch).tension_n
    expected = stretch.sum(axis=1, keepdims=True) / (1.0 / K).sum()
    np.testing.assert_allclose(tension, np.repeat(expected, 3, axis=1), rtol=close)


def test_the_work_that_a_loop_takes_is_lost_at_the_guides() -> None:
    there_and_back = np.concatenate([np.linspace(0, 4e-4, 401), np.linspace(4e-4, -1e-4, 501)[1:]])
    cycle = np.concatenate([there_and_back, np.linspace(-1e-4, 4e-4, 501)[1:]])
    course = searched(K, GRIP, pulled(cycle, 0))
    loop = slice(400, None)
    tension, passed = course.tension_n[loop], course.passed_m[loop]
    np.testing.assert_allclose(tension[0], tension[-1], rtol=1e-9)
    middle = 0.5 * (tension[1:] + tension[:-1])
    put_in = (middle[:, 0] * np.diff(cycle[loop])).sum()
    lost = np.abs(np.diff(middle, axis=1) * np.diff(passed, axis=0)).sum()
    assert put_in > 0.0
    assert put_in == pytest.approx(lost, rel=1e-9)


@pytest.mark.slow
@settings(max_examples=3, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_both_ways_agree_and_a_cable_may_be_turned_round(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stiffness, grip, stretch = random_history(rng, int(rng.integers(1, 4)), 10)
    one = searched(stiffness, grip, stretch, 8)
    mirrored = searched(stiffness[::-1], grip[::-1], stretch[:, ::-1], 8)
    np.testing.assert_allclose(mirrored.tension_n[:, ::-1], one.tension_n, atol=1e-5)
    # what is too much at a sliding guide goes with the speed, so with one over the steps
    fast, slow = (timed(stiffness, grip, stretch, steps).tension_n for steps in (1500, 3000))
    assert np.abs(2.0 * slow - fast - one.tension_n).max() < 0.005 * np.ptp(one.tension_n)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_law_of_the_simulator_finds_what_the_search_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stiffness, grip, stretch = random_history(rng, int(rng.integers(1, 4)), 12)
    expected = searched(stiffness, grip, stretch).tension_n
    np.testing.assert_allclose(tensions_by_law(stiffness, grip, stretch), expected, atol=1e-6)


def test_slack_cable_has_no_tension_and_comes_back_without_a_memory() -> None:
    stiffness, grip = K, GRIP
    way_m = np.array([0.0, 3e-4, -9e-4, 0.0])
    first = searched(stiffness, grip, pulled(way_m, 0), 50)
    straight = searched(stiffness, grip, pulled(way_m[[0, 2, 3]], 0), 50)
    assert not first.tension_n[2].any()
    np.testing.assert_allclose(first.tension_n[3], straight.tension_n[2], rtol=0.01)
