"""What friction carries, by the arm's motion and by the changes of its readings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cablesense_contact.arm_routes import arm_slides
from cablesense_contact.cable_slides import CableSlides, LastWay
from cablesense_contact.slides import (
    SLIDING_STD,
    Belief,
    KnownLengths,
    Slides,
    play_compliance_m_n,
    played,
)
from cablesense_plants.arm import statics
from cablesense_plants.arm.built import BuiltArm, Push, Workmanship
from cablesense_sim.arm import ListedEffect, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.uncertain_arm import arm_parameters
from tests.helpers.plant_arm import NOMINAL

ARM = open_arm("cdsm_lab")
MECHANISM = mechanism_of(ARM)
PARAMETERS = arm_parameters(ARM)
SLIDES = arm_slides(ARM)
COUNT = len(PARAMETERS)
FRICTION = PARAMETERS.slices["friction"].start
CARRIED = PARAMETERS.carried_friction
BODY = NOMINAL.body


def known(rng: np.random.Generator) -> Belief:
    """Everything is correlated with everything, where it is uncertain."""
    mixed = rng.normal(size=(COUNT, COUNT)) / np.sqrt(COUNT)
    std = PARAMETERS.prior_std
    return Belief(PARAMETERS.prior_mean, std[:, None] * (mixed @ mixed.T + np.eye(COUNT)) * std)


def with_friction(coefficient: float) -> Belief:
    mean = PARAMETERS.prior_mean.copy()
    mean[FRICTION] = coefficient
    return Belief(mean, np.zeros((COUNT, COUNT)))


def listing_friction(coefficient: float) -> CableSlides:
    """The slides of the arm whose file lists its friction, with a pulley of one radian."""
    parameters = {"coefficient": coefficient, "pulley_wrap_rad": 1.0, "run_compliance": 0.5}
    entry = ListedEffect(effect="capstan_friction", parameters=parameters)
    return arm_slides(ARM.model_copy(update={"effects": [entry]}))


def some_slides(rng: np.random.Generator) -> Slides:
    shape = SLIDES.unknown.mean.shape
    return Slides(rng.uniform(-1, 1, shape), rng.uniform(0.1, 0.5, shape))


def test_carried_friction_has_the_moments_of_slide_times_coefficient():
    """Against a million draws of both."""
    rng = np.random.default_rng(1)
    before = known(rng)
    slides = some_slides(rng)
    after = SLIDES.carried(before, slides)
    pair = [FRICTION, PARAMETERS.slices["pretension"].start]
    chosen = np.array([0, 30])  # of two cables, at the pulley and at a guide
    draws = 1_000_000
    coefficient, pretension_n = rng.multivariate_normal(
        before.mean[pair], before.covariance[np.ix_(pair, pair)], draws
    ).T
    slide = slides.mean.ravel()[chosen] + slides.std.ravel()[chosen] * rng.normal(size=(draws, 2))
    drawn = np.column_stack([slide * coefficient[:, None], coefficient, pretension_n])
    rows = np.concatenate([CARRIED.start + chosen, pair])
    scale = drawn.std(axis=0)
    assert_allclose(after.mean[rows] / scale, drawn.mean(axis=0) / scale, atol=5e-3)
    stated = after.covariance[np.ix_(rows, rows)] / np.outer(scale, scale)
    assert_allclose(stated, np.cov(drawn.T) / np.outer(scale, scale), atol=5e-3)


def test_a_covariance_stays_one():
    rng = np.random.default_rng(2)
    after = SLIDES.carried(known(rng), some_slides(rng))
    scale = np.where(PARAMETERS.prior_std > 0.0, PARAMETERS.prior_std, 1.0)
    assert np.linalg.eigvalsh(after.covariance / np.outer(scale, scale)).min() > -1e-9
    absent = np.flatnonzero(PARAMETERS.prior_std == 0.0)
    assert (after.covariance[absent] == 0.0).all()


def test_a_bent_joint_draws_cable_over_the_guides_before_it():
    bent = np.zeros(MECHANISM.joint_count)
    bent[4] = np.deg2rad(8.0)  # joint 3
    slides = SLIDES.after_motion(np.zeros_like(bent), bent)
    passes = MECHANISM.passes_joint[:, 2]
    for guide in range(4):
        assert (np.abs(slides.mean[guide, passes]) > 0.9).sum() >= 4
        assert_array_equal(slides.mean[guide, ~passes], 0.0)
    assert_array_equal(slides.mean[4], 0.0)
    back = SLIDES.after_motion(bent, np.zeros_like(bent))
    assert_allclose(back.mean, -slides.mean, atol=0.05)


def test_only_the_last_of_a_way_counts():
    way = LastWay()
    assert way.came_from_rad is None
    for angle_deg in (0.0, 5.0, 5.4, 5.8, 6.2):
        way = way.to(np.array([np.deg2rad(angle_deg)]))
    assert_allclose(np.rad2deg(way.came_from_rad), [5.0])
    assert way.forgotten.came_from_rad is None


def test_where_nothing_passes_a_slide_stays():
    """Within what is always unsure of one that has slid."""
    rng = np.random.default_rng(8)
    mean = rng.uniform(-1.0, 1.0, (3, 4))
    std = rng.uniform(SLIDING_STD, 1.0, mean.shape) * np.sqrt(1.0 - mean**2)
    std = np.maximum(std, SLIDING_STD)
    before = Slides(mean, std)
    after = played(
        before, KnownLengths(np.zeros_like(mean), np.zeros_like(mean)), np.full((3, 4), 1e-5)
    )
    possible = std**2 <= 1.0 - mean**2
    assert_allclose(after.mean, mean, atol=1e-9)
    assert_allclose(after.std[possible], std[possible], rtol=1e-6)


def test_the_play_is_used_up_on_the_way_back():
    """From one slide to the other over the play; within it, in proportion to what has passed."""
    forth = Slides(np.ones((1, 5)), np.full((1, 5), SLIDING_STD))
    back_m = -1e-5 * np.array([[0.0, 0.25, 0.5, 1.0, 3.0]])
    after = played(forth, KnownLengths(back_m, np.zeros_like(back_m)), np.full((1, 5), 1e-5))
    assert_allclose(after.mean, [[1.0, 0.5, 0.0, -1.0, -1.0]], atol=1e-9)
    assert_allclose(after.std, SLIDING_STD)


def test_moments_of_a_slide_are_those_of_draws():
    """Of a cable that slid one way or the other, or stuck, and of what passed, roughly known."""
    rng = np.random.default_rng(9)
    draws = 400_000
    for mean, std, passed_m, passed_std_m in (
        (0.3, 0.5, 2e-6, 3e-6),
        (-0.9, 0.2, 8e-6, 4e-6),
        (0.0, 1.0, -1e-6, 1e-7),
    ):
        slid = rng.random(draws) < std**2 / (1.0 - mean**2)
        direction = np.where(rng.random(draws) < 0.5 * (1.0 + mean), 1.0, -1.0)
        before = np.where(slid, direction, mean)
        drawn_m = passed_m + passed_std_m * rng.normal(size=draws)
        drawn = np.clip(before + 2.0 * drawn_m / 1e-5, -1.0, 1.0)
        stated = Slides(np.full((1, 1), mean), np.full((1, 1), std))
        passed = KnownLengths(np.full((1, 1), passed_m), np.full((1, 1), passed_std_m))
        after = played(stated, passed, np.full((1, 1), 1e-5))
        assert_allclose(after.mean, drawn.mean(), atol=5e-3)
        assert_allclose(after.std, drawn.std(), atol=5e-3)


def test_pieces_beside_a_guide_are_springs_in_series():
    compliance_m_n = np.array([[1.0, 2.0, 3.0]])
    assert_allclose(play_compliance_m_n(compliance_m_n), [[5.0 / 6.0, 1.5]])


@pytest.mark.slow
def test_small_motions_leave_the_slides_of_the_plant():
    """Many guides stick halfway, as they do not slide over the whole of their play."""
    friction = 0.15
    rng = np.random.default_rng(10)
    built = BuiltArm(NOMINAL, Workmanship().scaled(0.0), rng, friction=friction)
    listed = listing_friction(friction)
    walk = built.walk(np.zeros(8))
    command = np.full(8, 0.1)
    walk.go(command)
    by_std_at_pulleys: list[float] = []
    off_at_plates: list[float] = []
    for _ in range(12):
        before = command
        command = np.clip(command + np.deg2rad(rng.uniform(-2.0, 2.0, 8)), -0.17, 0.17)
        walk.go(command)
        slides = listed.after_motion(before, command)
        plates = at_plates(walk, friction)
        off = at_pulleys(walk, friction) - slides.mean[0]
        by_std_at_pulleys.extend(off / slides.std[0])
        off_at_plates.extend((plates.slide - slides.mean[1:])[plates.exists])
    assert np.sqrt(np.mean(np.square(by_std_at_pulleys))) < 1.0
    assert np.sqrt(np.mean(np.square(off_at_plates))) < 0.2  # two plates, taken as one guide


@pytest.mark.slow
def test_slides_are_those_of_the_plant():
    """It knows each guide's: after motions, and at the pulleys when it is pushed and released."""
    friction = 0.05
    rng = np.random.default_rng(3)
    exact = Workmanship().scaled(0.0)
    built = BuiltArm(NOMINAL, exact, rng, friction=friction)
    command = np.zeros(8)
    walk = built.walk(command)
    right = []
    moved = []
    for _ in range(4):
        before = command
        command = rng.uniform(-0.17, 0.17, 8)
        untouched_n = walk.go(command).copy()
        arrived = SLIDES.after_motion(before, command)
        sure = np.abs(arrived.mean[0]) > 0.9
        right += list(arrived.mean[0, sure] * at_pulleys(walk, friction)[sure])
        under_load = SLIDES.under_load(command, untouched_n, with_friction(friction), arrived)
        force_n = built.axes(command)[2] @ np.array([0.0, 20.0, 10.0])
        pushed_n = walk.go(command, [Push(3, 0.08, force_n)]).copy()
        slides = under_load.after(pushed_n).slides
        slid = np.abs(pushed_n - untouched_n) > 0.4
        moved += list(slides.mean[0, slid] * at_pulleys(walk, friction)[slid])
        walk.go(command)
    assert np.mean(right) > 0.99
    assert np.mean(moved) > 0.9


class PushedWalk:
    """An exact arm whose cables rub, on its way from one random pose to the next.

    Attributes:
        walk: of the plant.
        untouched_n: (M,) readings in the present pose, and
        pushed_n: (M,) those under the push.
        under_load: what the latter say of slides.
    """

    def __init__(self, friction: float, push_n: float, seed: int) -> None:
        self.friction = friction
        self.push_n = push_n
        self.rng = np.random.default_rng(seed)
        exact = Workmanship().scaled(0.0)
        self.built = BuiltArm(NOMINAL, exact, self.rng, friction=friction)
        self.command = np.zeros(8)
        self.walk = self.built.walk(self.command)

    def go_and_be_pushed(self) -> None:
        """Go to another pose, and be pushed in the middle of a segment from 2 on."""
        before = self.command
        self.command = self.rng.uniform(-0.17, 0.17, 8)
        self.untouched_n = self.walk.go(self.command).copy()
        arrived = SLIDES.after_motion(before, self.command)
        known = with_friction(self.friction)
        under_load = SLIDES.under_load(self.command, self.untouched_n, known, arrived)
        segment = int(self.rng.integers(2, 5))
        angle = self.rng.uniform(0.0, 2.0 * np.pi)
        across_n = self.push_n * np.array([0.0, np.sin(angle), np.cos(angle)])
        axes = self.built.axes(self.command)[segment - 1]
        self.pushed_n = self.walk.go(self.command, [Push(segment, 0.06, axes @ across_n)]).copy()
        self.under_load = under_load.after(self.pushed_n)

    def release(self) -> np.ndarray:
        """(M,) readings once the push is gone."""
        return self.walk.go(self.command).copy()


@pytest.mark.slow
def test_a_cable_that_moved_little_while_others_moved_much_may_have_turned_back():
    """The tension behind its pulley rose and fell; what is stated of its slide covers that."""
    course = PushedWalk(friction=0.05, push_n=30.0, seed=5)
    off_by_std: list[float] = []

    def note(slides: Slides, change_n: np.ndarray) -> None:
        size_n = np.abs(change_n)
        little = (size_n > 0.4) & (size_n < 0.1 * size_n.max())
        off = at_pulleys(course.walk, course.friction) - slides.mean[0]
        off_by_std.extend(off[little] / slides.std[0, little])

    for _ in range(12):
        course.go_and_be_pushed()
        note(course.under_load.slides, course.pushed_n - course.untouched_n)
        released_n = course.release()
        slides = course.under_load.after(released_n).slides
        note(slides, released_n - course.pushed_n)
    assert len(off_by_std) > 40
    assert np.sqrt(np.mean(np.square(off_by_std))) < 1.2


@pytest.mark.slow
def test_slides_behind_the_pulleys_are_within_what_is_stated_of_them():
    """Against the plant, at the plates before each joint, when the arm is pushed."""
    course = PushedWalk(friction=0.1, push_n=25.0, seed=6)
    off_by_std: list[float] = []
    for _ in range(16):
        course.go_and_be_pushed()
        slides = course.under_load.slides
        slid = np.abs(course.pushed_n - course.untouched_n) > 0.4
        plates = at_plates(course.walk, course.friction)
        off = (plates.slide - slides.mean[1:]) / slides.std[1:]
        off_by_std.extend(off[plates.exists & slid])
        course.release()
    assert len(off_by_std) > 200
    assert np.sqrt(np.mean(np.square(off_by_std))) < 1.0
    assert np.mean(np.abs(off_by_std) > 2.0) < 0.05


class AtPlates(NamedTuple):
    """Slides (G - 1, M) over the plates before each joint, and where a taut cable bends there."""

    slide: np.ndarray
    exists: np.ndarray


def at_plates(walk, friction: float) -> AtPlates:
    """By the plant's tensions and bends.

    Cables pass the base plate, then two plates of each segment, between which they are straight.
    """
    angles_rad = walk.state.angles_rad[None]
    turning = statics.turns(BODY, angles_rad)
    bend_rad = statics.spans(BODY, angles_rad, turning, with_bends=True).bend_rad[0]
    bend_rad = bend_rad.reshape(-1, BODY.cable_count)
    tension_n = walk.state.tension_n.T
    before_joint_n = tension_n[[1, 2, 4, 6]]
    behind_n = tension_n[[2, 4, 6, 8]]
    wrap_rad = np.concatenate([bend_rad[:1], bend_rad[1:7].reshape(3, 2, -1).sum(axis=1)])
    exists = (wrap_rad > 1e-3) & (tension_n.min(axis=0) > 2.0)
    ratio = np.where(exists, behind_n, 1.0) / np.where(exists, before_joint_n, 1.0)
    return AtPlates(np.log(ratio) / (friction * np.where(exists, wrap_rad, 1.0)), exists)


def at_pulleys(walk, friction: float) -> np.ndarray:
    """(M,) slides over the pulleys, of one radian, by the tensions on both sides."""
    tension_n = np.maximum(walk.state.tension_n, 1e-3)
    return np.log(tension_n[:, 1] / tension_n[:, 0]) / friction


def test_where_nothing_moves_slides_stay_as_they_came():
    rng = np.random.default_rng(4)
    arrived = some_slides(rng)
    untouched_n = np.full(12, 50.0)
    under_load = SLIDES.under_load(np.zeros(8), untouched_n, with_friction(0.05), arrived)
    assert under_load.after(untouched_n + rng.uniform(-0.3, 0.3, 12)).slides is arrived


def test_where_a_load_is_taken_off_cables_slide_back():
    untouched_n = np.full(12, 50.0)
    under_load = SLIDES.under_load(np.zeros(8), untouched_n, with_friction(0.05))
    push_n = np.linspace(-9.0, 9.0, 12)
    under_load = under_load.after(untouched_n + push_n)
    assert_array_equal(under_load.slides.mean[0], np.sign(push_n))
    released = under_load.after(untouched_n + 0.2 * push_n).slides
    turned = np.abs(0.8 * push_n) > 0.4
    assert_array_equal(released.mean[0, turned], -np.sign(push_n[turned]))


def test_a_coefficient_below_zero_counts_as_none():
    """So it may be after readings of an arm whose cables do not rub."""
    untouched_n = np.full(12, 50.0)
    push_n = np.linspace(-9.0, 9.0, 12)
    (slides, of_none) = (
        SLIDES.under_load(np.zeros(8), untouched_n, with_friction(coefficient))
        .after(untouched_n + push_n)
        .slides
        for coefficient in (-0.01, 0.0)
    )
    assert_array_equal(slides.mean, of_none.mean)
    assert_array_equal(slides.std, of_none.std)
    assert (slides.std > 0.0).all()
