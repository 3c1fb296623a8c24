"""Place and force of a contact anywhere on the arm: recovered, covered, or said to be unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.contact_location import (
    AXIAL_STD_N,
    LARGEST_N,
    Surface,
    contact_information,
    locate,
    locate_two,
    reach_m,
    torque_balance,
)
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.replay import difference_variance_n2, read_tensions_n

ARMS = {"cdsm": 150.0, "cdsm_lab": 50.0}
TARE_SAMPLES = 50


class Contacts:
    """Random contacts on an arm, K on segments of each sample, and the tensions of its rest."""

    def __init__(
        self, name, count=400, bend_deg=10.0, axial=0.3, segments=((2,), (3,), (4,)), seed=0
    ):
        self.rng = rng = np.random.default_rng(seed)
        self.arm, self.mechanism = open_arm(name), mechanism_of(open_arm(name))
        bend = np.deg2rad(bend_deg)
        self.command = rng.uniform(-bend, bend, (count, self.mechanism.joint_count))
        self.segments = np.array(segments)[rng.integers(0, len(segments), count)]
        shape = self.segments.shape
        low, high = reach_m(self.mechanism)[0]
        self.places_m = rng.uniform(low, high, shape)
        least_n, share = (2.0, 1.0) if shape[1] == 1 else (5.0, 0.4)
        size = rng.uniform(least_n, share * ARMS[name], shape)
        angle, along = rng.uniform(0.0, 2.0 * np.pi, shape), axial * rng.uniform(-1.0, 1.0, shape)
        unit = np.stack([along, np.sin(angle), np.cos(angle)], axis=-1)
        self.forces_n = size[..., None] * unit
        self.variance_n2 = difference_variance_n2(self.arm.sensors, TARE_SAMPLES)
        self.unloaded_n = solve_equilibrium(self.mechanism, self.command).tensions_n
        rest = self.at_rest(self.places_m, self.forces_n)
        self.loaded_n, self.pose_rad = rest.tensions_n, rest.joint_angles_rad

    @property
    def alone(self):
        """Segment, place and force of the first contact of each sample."""
        return self.segments[:, 0], self.places_m[:, 0], self.forces_n[:, 0]

    @property
    def lateral_n(self):
        return np.linalg.norm(self.forces_n[:, 0, 1:], axis=1)

    def touched_m(self, radius_m):
        """Where the surface is touched, if its friction makes the axial forces (B, K), m."""
        every, n = np.arange(len(self.segments))[:, None], self.segments - 1
        commanded, true = (
            kinematics.segment_rotations(self.mechanism, pose)[every, n]
            for pose in (self.command, self.pose_rad)
        )
        force = np.einsum("bkji,bkjl,bkl->bki", true, commanded, self.forces_n)
        return self.places_m - radius_m * force[..., 0] / np.hypot(force[..., 1], force[..., 2])

    def at_rest(self, places_m, forces_n):
        every, n = np.arange(len(self.segments))[:, None], self.segments - 1
        reach = np.tile(self.mechanism.contact_m, (len(n), 1))
        reach[every, n] = places_m
        axes = kinematics.segment_rotations(self.mechanism, self.command)[every, n]
        forces = np.zeros((len(n), self.mechanism.segment_count, 3))
        forces[every, n] = (axes @ forces_n[..., None])[..., 0]
        return solve_equilibrium(replace(self.mechanism, contact_m=reach), self.command, forces)

    def balance(self, *, noise=True, loaded_n=None):
        loaded_n = self.loaded_n if loaded_n is None else loaded_n
        difference_n = loaded_n - self.unloaded_n
        if noise:
            tare = [
                read_tensions_n(self.unloaded_n, self.arm.sensors, self.rng)
                for _ in range(TARE_SAMPLES)
            ]
            read_n = read_tensions_n(loaded_n, self.arm.sensors, self.rng)
            difference_n = read_n - np.mean(tare, axis=0)
        return torque_balance(self.mechanism, self.command, difference_n, self.variance_n2)

    def located(self, surface=None, **how):
        return locate(self.balance(**how), reach_m(self.mechanism), surface)

    def information(self):
        return contact_information(self.mechanism, self.command, *self.alone, self.variance_n2)


def two_contacts(name, count=150, axial=0.0, seed=0):
    """On different segments beyond the first, in bent poses."""
    return Contacts(name, count, axial=axial, segments=((2, 3), (2, 4), (3, 4)), seed=seed)


def within(value, interval):
    return (value >= interval[:, 0]) & (value <= interval[:, 1])


@pytest.mark.parametrize("name", ARMS)
def test_without_noise_place_and_force_are_exact_where_the_pose_shows_them(name):
    contacts = Contacts(name, count=100)
    segment, place_m, force_n = contacts.alone
    found = contacts.located(noise=False)
    np.testing.assert_array_equal(found.segment, segment)
    # the grid ends at a bound, so a mean next to an end is a fraction of its deviation inwards
    off = np.abs(found.place_m - place_m)
    assert np.median(off) < 1e-5
    assert (off < 0.5 * np.diff(found.place_ci95_m)[:, 0]).all()
    assert np.median(np.abs(found.force_n - force_n)) < 5e-3


def test_torques_are_exact_where_slack_cables_hang_far_below_their_guides():
    contacts = Contacts("cdsm_lab", count=200, seed=11)
    segment, place_m, force_n = contacts.alone
    loaded_n = contacts.at_rest(contacts.places_m, 3.0 * contacts.forces_n).tensions_n
    assert ((loaded_n <= 0.0).sum(axis=1) > 3).any()
    balance = contacts.balance(noise=False, loaded_n=loaded_n)
    every = np.arange(len(loaded_n))
    lever = balance.by_force_m[every, segment - 1]
    lever = lever + place_m[:, None, None] * balance.by_place[every, segment - 1]
    off = balance.torque_n_m - np.einsum("bcj,bc->bj", lever, 3.0 * force_n)
    # but for cables so nearly slack that they count as such
    known = ((loaded_n <= 0.0) | (loaded_n > 1.0)).all(axis=1)
    assert np.abs(off[known]).max() < 1e-3


@pytest.mark.parametrize("name", ARMS)
def test_information_agrees_with_differences_of_the_equilibrium(name):
    contacts = Contacts(name, count=20, seed=1)
    columns = []
    for force_step, place_step in (*((step, 0.0) for step in 1e-3 * np.eye(3)), (0.0, 1e-6)):
        ahead, behind = (
            contacts.at_rest(
                contacts.places_m + sign * place_step, contacts.forces_n + sign * force_step
            ).tensions_n
            for sign in (1.0, -1.0)
        )
        columns.append((ahead - behind) / (2.0 * np.max(force_step + place_step)))
    gain = np.stack(columns, axis=-1)
    expected = np.swapaxes(gain, 1, 2) @ gain / contacts.variance_n2
    np.testing.assert_allclose(contacts.information(), expected, rtol=2e-3, atol=2.0)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("bend_deg", [0.0, 10.0])
def test_errors_are_those_of_the_noise_and_the_intervals_cover(name, bend_deg):
    contacts = Contacts(name, bend_deg=bend_deg, axial=0.3 if bend_deg else 0.0, seed=2)
    segment, place_m, _ = contacts.alone
    found = contacts.located()
    right = found.segment == segment
    assert right.mean() >= 0.99
    low, high = reach_m(contacts.mechanism)[0]
    prior = np.diag([AXIAL_STD_N**-2, 0.0, 0.0, 12.0 / (high - low) ** 2])
    bound = np.linalg.inv(contacts.information() + prior)[:, [3, 0, 1, 2]][..., [3, 0, 1, 2]]
    bound_m = np.sqrt(bound[:, 0, 0])
    if bend_deg:  # inside the segment, where the prior cuts nothing off
        inner = right & (place_m - low > 4 * bound_m) & (high - place_m > 4 * bound_m)
        assert inner.sum() > 50
        root = np.linalg.cholesky(bound[inner])
        whitened = np.linalg.solve(root, found.covariance[inner]) @ np.linalg.inv(root).mT
        assert np.median(np.abs(whitened - np.eye(4))) < 0.1
    off = ((found.place_m - place_m) / bound_m)[right]
    assert np.sqrt((off**2).mean()) < 1.2
    assert 0.91 < within(place_m, found.place_ci95_m)[right].mean() <= 0.99
    assert 0.91 < within(contacts.lateral_n, found.magnitude_ci95_n)[right].mean() <= 0.99
    # chi² of 2N - 4 free residuals, a few more where the axial force stays unknown
    assert 3.0 < np.median(found.chi2[right]) < 5.5


def test_on_segment_1_the_moment_is_known_and_force_and_place_are_not():
    contacts = Contacts("cdsm", segments=((1,),), axial=0.0, seed=3)
    _, place_m, force_n = contacts.alone
    found = contacts.located()
    right = found.segment == 1
    assert right.mean() > 0.99
    moment = place_m[:, None] * force_n[:, [2, 1]] * [-1.0, 1.0]
    off = np.abs(found.moment_n_m - moment) / found.moment_std_n_m
    assert 0.91 < (off < 1.96)[right].mean() <= 0.99
    low, high = reach_m(contacts.mechanism)[0]
    assert within(contacts.lateral_n, found.magnitude_ci95_n)[right].mean() > 0.93
    assert within(place_m, found.place_ci95_m)[right].mean() > 0.93
    assert (found.magnitude_ci95_n <= LARGEST_N + 1.0).all()
    # nothing but the largest force expected narrows the place
    weak = right & (np.linalg.norm(moment, axis=1) < LARGEST_N * low)
    assert (np.diff(found.place_ci95_m)[weak] > 0.8 * (high - low)).all()


def test_a_straight_stiff_arm_does_not_show_the_axial_force():
    contacts = Contacts("cdsm", bend_deg=0.0, axial=0.5, seed=4)
    found = contacts.located()
    assert np.median(found.force_std_n[:, 0]) > 0.9 * AXIAL_STD_N
    bent = Contacts("cdsm", segments=((4,),), axial=0.5, seed=4).located()
    assert np.median(bent.force_std_n[:, 0]) < 0.5


def test_the_posterior_agrees_with_a_dense_grid_of_places_and_weighted_least_squares():
    """The reference solves each place by lstsq on whitened torques, and knows no Newton step."""
    contacts = Contacts("cdsm_lab", count=12, seed=9)
    balance, n = contacts.balance(), contacts.segments[:, 0] - 1
    found = locate(balance, reach_m(contacts.mechanism))
    for b in range(len(n)):
        root = np.linalg.cholesky(balance.precision[b]).T
        centre, half = found.place_m[b], 8.0 * np.diff(found.place_ci95_m[b])[0]
        low, high = reach_m(contacts.mechanism)[n[b]]
        places = np.linspace(max(low, centre - half), min(high, centre + half), 1001)
        density = []
        for place in places:
            lever = balance.by_force_m[b, n[b]] + place * balance.by_place[b, n[b]]
            columns = np.vstack([root @ lever.T, [1.0 / AXIAL_STD_N, 0.0, 0.0]])
            target = np.append(root @ balance.torque_n_m[b], 0.0)
            force, _, _, singular = np.linalg.lstsq(columns, target)
            chi2 = ((target - columns @ force) ** 2).sum()
            density.append(-0.5 * chi2 - np.log(singular).sum() - np.log(np.hypot(*force[1:])))
        weight = np.exp(np.array(density) - max(density))
        below = np.cumsum(weight) / weight.sum()
        expected = np.interp([0.025, 0.975], below, places)
        np.testing.assert_allclose(
            found.place_ci95_m[b], expected, atol=0.05 * np.diff(expected)[0]
        )


@pytest.mark.parametrize("segment", [1, 2, 3, 4])
@pytest.mark.parametrize("name", ARMS)
def test_with_friction_intervals_cover_in_bent_poses(name, segment):
    surface = Surface(0.05, 0.3)
    contacts = Contacts(name, axial=surface.friction, segments=((segment,),), seed=8)
    # a force at the surface turns the joints as one on the axis that is shifted
    place_m = contacts.touched_m(surface.radius_m)[:, 0]
    low, high = reach_m(contacts.mechanism)[0]
    inside = (place_m > low) & (place_m < high)
    found = contacts.located(surface)
    right = inside & (found.segment == segment)
    assert right.sum() > 0.97 * inside.sum()
    assert within(place_m, found.place_ci95_m)[right].mean() > 0.91
    assert within(contacts.lateral_n, found.magnitude_ci95_n)[right].mean() > 0.91


@pytest.mark.parametrize("name", ARMS)
def test_through_the_joints_nothing_is_confident_and_wrong(name):
    length = 0.13
    contacts = Contacts(name, count=600, seed=11)
    segment, low, high = contacts.segments[:, 0], *reach_m(contacts.mechanism)[0]
    # from the end of one segment to the reach of the next, where the two are one place
    near = contacts.rng.uniform(0.0, 0.004, (600, 1))
    end = contacts.rng.random((600, 1)) < 0.5
    places_m = np.where(end, high - near, low + near)
    loaded_n = contacts.at_rest(places_m, contacts.forces_n).tensions_n
    found = contacts.located(loaded_n=loaded_n)
    sure = found.probability.max(axis=1) > 0.99
    right = found.segment == segment
    assert right[sure].mean() > 0.99
    along_m = length * segment + places_m[:, 0]
    region_m = length * found.region_segment + found.region_m
    assert within(along_m, region_m + np.array([-1e-9, 1e-9])).mean() > 0.93
    assert (np.abs(length * found.segment + found.place_m - along_m)[~right] < 0.03).all()


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("bend_deg", [0.0, 10.0])
@pytest.mark.parametrize("surface", [None, Surface(0.055, 0.3)])
def test_the_force_is_known_apart_from_its_place_beyond_segment_1_only(name, bend_deg, surface):
    axial = 0.0 if surface is None else 0.1
    first = Contacts(name, 200, bend_deg=bend_deg, axial=axial, segments=((1,),), seed=12)
    found = first.located(surface)
    weak = np.linalg.norm(found.moment_n_m, axis=1) < 4.0  # else the largest force bounds it
    assert found.force_known[weak].mean() < 0.05
    beyond = Contacts(name, bend_deg=bend_deg, axial=axial, count=300, seed=12)
    # in a bent pose an axial force can hide part of the lateral one, rarely
    assert beyond.located(surface).force_known[beyond.lateral_n >= 5.0].mean() > 0.97


@pytest.mark.parametrize("name", ARMS)
def test_an_untouched_arm_is_not_touched(name):
    contacts = Contacts(name, count=500, seed=6)
    found = contacts.located(loaded_n=contacts.unloaded_n)
    assert (found.segment == 0).mean() > 0.99
    assert (found.magnitude_ci95_n[:, 0] < 0.3).all()


@pytest.mark.parametrize("name", ARMS)
def test_two_contacts_agree_with_least_squares_over_places_and_forces(name):
    """The reference fits all eight numbers at once, from the true ones, by another method."""
    contacts = two_contacts(name, count=60, seed=13)
    balance, reach = contacts.balance(), reach_m(contacts.mechanism)
    found = locate_two(balance, reach)
    right = (found.segments == contacts.segments).all(axis=1)
    assert right.mean() > 0.7
    determined = 0
    for b in np.flatnonzero(right):
        segments = contacts.segments[b] - 1
        root = np.linalg.cholesky(balance.precision[b]).T
        at_joint, slope = (part[b, segments] for part in (balance.by_force_m, balance.by_place))
        # normal to the motion of the segment by its own joints
        own = [slope[k][:, 2 * n : 2 * n + 2] for k, n in enumerate(segments)]
        axes = np.array([np.cross(*each.T) / np.linalg.norm(np.cross(*each.T)) for each in own])

        def left(numbers, root=root, at_joint=at_joint, slope=slope, axes=axes, b=b):
            forces, places = numbers[:6].reshape(2, 3), numbers[6:]
            torques = np.einsum("kc,kcj->j", forces, at_joint + places[:, None, None] * slope)
            return np.append(
                root @ (balance.torque_n_m[b] - torques), (forces * axes).sum(axis=1) / AXIAL_STD_N
            )

        low, high = reach[segments].T
        fitted = least_squares(
            left,
            np.append(contacts.forces_n[b], contacts.places_m[b]),
            bounds=(np.append([-np.inf] * 6, low), np.append([np.inf] * 6, high)),
            x_scale=np.append(np.full(6, 1.0), [0.01, 0.01]),
            xtol=1e-12,
            ftol=1e-12,
        )
        # the reference may end at a local minimum, this fit along a valley
        assert found.chi2[b] < 2.0 * fitted.cost + 0.2
        information = fitted.jac.T @ fitted.jac
        information[[6, 7], [6, 7]] += 12.0 / (high - low) ** 2
        std = np.sqrt(np.diagonal(np.linalg.inv(information)))
        if (std[6:] < 5e-3).all():
            determined += 1
            stated = np.append(found.force_n[b], found.place_m[b])
            assert (np.abs(stated - fitted.x) < 0.05 * std).all()
            stated_std = np.append(found.force_std_n[b], found.place_std_m[b])
            np.testing.assert_allclose(stated_std, std, rtol=0.02)
    assert determined > 10


@pytest.mark.parametrize("name", ARMS)
def test_friction_of_two_contacts_shifts_the_places_and_the_deviations_cover_it(name):
    surface = Surface(0.055, 0.3)
    contacts = two_contacts(name, axial=surface.friction, seed=14)
    balance, reach = contacts.balance(), reach_m(contacts.mechanism)
    place_m, (low, high) = contacts.touched_m(surface.radius_m), reach[0]
    inside = ((place_m > low) & (place_m < high)).all(axis=1)

    def covered(found):
        right = inside & (found.segments == contacts.segments).all(axis=1)
        assert right.sum() > 0.75 * inside.sum()
        return (np.abs(found.place_m - place_m) < 1.96 * found.place_std_m)[right].mean()

    assert covered(locate_two(balance, reach)) < 0.75
    aware = locate_two(balance, reach, surface=surface)
    assert covered(aware) > 0.93
    # friction bounds the axial forces, which would hide the places otherwise
    assert np.median(aware.place_std_m) < surface.radius_m * surface.friction


@pytest.mark.parametrize("surface", [None, Surface(0.055, 0.3)])
@pytest.mark.parametrize("name", ARMS)
def test_evidence_tells_one_contact_from_two(name, surface):
    two, one = two_contacts(name, seed=7), Contacts(name, count=150, seed=7)
    for contacts, expected in ((two, True), (one, False)):
        balance, reach = contacts.balance(), reach_m(contacts.mechanism)
        pair = locate_two(balance, reach, surface=surface)
        more = pair.log_evidence - locate(balance, reach, surface).log_evidence
        assert ((more > 0.0) == expected).mean() > 0.97
