"""The posterior of a contact and its rivals: held intervals, symmetry, bounds, and faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cablesense_sim.arm import open_arm
from cablesense_sim.noise_bound import contact_information
from tests.helpers.arm_variants import variant
from tests.helpers.law_arms import NOISE_STD_N, LawArm, Push

SAME_IN_A_MIRROR = (
    "contact_evidence",
    "segment_evidence",
    "several_evidence",
    "place_m",
    "place_ci95_m",
    "region_m",
    "magnitude_ci95_n",
    "moment_std_n_m",
)


@pytest.fixture(scope="module")
def lab():
    return LawArm(open_arm("cdsm_lab"))


def prior(law):
    """Mean and covariance by the tolerances, without friction."""
    std = law.within_the_statics(law.parameters.prior_std)
    return np.zeros(len(std)), np.diag(std**2)


def drawn_push(rng, segments=(0, 1, 2, 3)):
    magnitude_n = rng.uniform(5.0, 40.0)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    axial_n = rng.uniform(-0.3, 0.3) * magnitude_n
    force_n = (axial_n, magnitude_n * np.sin(angle), magnitude_n * np.cos(angle))
    return Push(int(rng.choice(segments)), rng.uniform(0.0, 0.13), force_n)


def test_intervals_of_drawn_arms_hold(lab):
    rng = np.random.default_rng(0)
    count = 200
    commands = np.stack([lab.command(rng) for _ in range(count)])
    pushes = [drawn_push(rng) for _ in range(count)]
    readings = []
    for command, push in zip(commands, pushes, strict=True):
        theta = lab.within_the_statics(lab.parameters.drawn(rng))
        exact = lab.read(theta, command, [push])
        readings.append(exact + rng.normal(0.0, NOISE_STD_N, len(exact)))
    answer = lab.answer(np.array(readings), commands, *prior(lab))
    starts = np.concatenate([[0.0], np.cumsum(lab.mechanism.segment_length_m)])
    along = np.array([starts[push.segment] + push.place_m for push in pushes])
    lateral = np.array([np.hypot(*push.force_n[1:]) for push in pushes])
    for value, interval in ((along, answer.region_m), (lateral, answer.magnitude_ci95_n)):
        held = (interval[:, 0] <= value) & (value <= interval[:, 1])
        assert 0.90 <= held.mean() <= 0.995
    # one contact leaves what noise and tolerances do: 12 readings less 4 numbers
    assert 7.0 < np.median(answer.contact_chi2) < 9.5


def test_a_mirrored_arm_gives_the_mirrored_answer(lab):
    """Left and right exchanged: yaw, f_y and the moment about z change their signs."""
    mechanism = lab.mechanism
    mirrored = LawArm(
        open_arm("cdsm_lab"),
        replace(
            mechanism, hole_y_m=-mechanism.hole_y_m, segment_hole_y_m=-mechanism.segment_hole_y_m
        ),
    )
    rng = np.random.default_rng(1)
    mean, covariance = prior(lab)
    for segment in range(4):
        command = lab.command(rng)
        reading = lab.read(mean, command, [drawn_push(rng, [segment])])
        reading = reading + rng.normal(0.0, NOISE_STD_N, len(reading))
        here = lab.answer(reading, command, mean, covariance)
        there = mirrored.answer(reading, command * np.tile([1.0, -1.0], 4), mean, covariance)
        for name in SAME_IN_A_MIRROR:
            expected = getattr(here, name)
            np.testing.assert_allclose(getattr(there, name), expected, rtol=1e-5, atol=1e-6)
        flipped = here.force_n * [1.0, -1.0, 1.0]
        np.testing.assert_allclose(there.force_n, flipped, atol=1e-5)
        # a moment is an axial vector: the one about the axis across the mirror keeps its sign
        np.testing.assert_allclose(there.moment_n_m, here.moment_n_m * [1.0, -1.0], atol=1e-5)


def test_deviations_on_a_known_arm_are_those_of_the_cramer_rao_bound(lab):
    rng = np.random.default_rng(2)
    nothing = np.zeros(len(lab.parameters))
    for segment in (1, 2, 3):
        for _ in range(5):
            command = lab.command(rng)
            angle = rng.uniform(0.0, 2.0 * np.pi)
            force = np.array([0.0, 20.0 * np.sin(angle), 20.0 * np.cos(angle)])
            place = rng.uniform(0.03, 0.1)
            reading = lab.read(nothing, command, [Push(segment, place, tuple(force))])
            answer = lab.answer(reading, command, nothing)
            assert answer.contact_evidence.argmax() == segment
            information = contact_information(
                lab.mechanism,
                command[None],
                np.array([segment + 1]),
                np.array([place]),
                force[None],
                NOISE_STD_N**2,
            )[0]
            # the axial force has a prior deviation of 100 N
            information[0, 0] += 100.0**-2
            bound = np.sqrt(np.diag(np.linalg.inv(information)))
            stated = np.sqrt(np.diag(answer.contact_covariance))
            np.testing.assert_allclose(stated[[2, 3, 0]], bound[[1, 2, 3]], rtol=0.2)


def test_contacts_are_stated_where_the_arm_is_said_to_be_touched(lab):
    """Within `touch.reach_m`; a push outside of it is none that this estimator explains."""
    near_m, far_m = 0.05, 0.09
    within = LawArm(variant({"touch": {"reach_m": [near_m, far_m]}}, "cdsm_lab"))
    rng = np.random.default_rng(8)
    mean, covariance = prior(lab)
    for place_m in (0.02, 0.07, 0.12):
        command = lab.command(rng)
        push = Push(2, place_m, (0.0, 24.0, 32.0))
        reading = lab.read(mean, command, [push])
        whole = lab.answer(reading, command, mean, covariance)
        answer = within.answer(reading, command, mean, covariance)
        assert near_m <= answer.place_ci95_m[0] <= answer.place_m <= answer.place_ci95_m[1]
        assert answer.place_ci95_m[1] <= far_m
        assert whole.place_m == pytest.approx(place_m, abs=0.01)
        if near_m <= place_m <= far_m:
            assert answer.place_m == pytest.approx(place_m, abs=0.01)
        else:
            assert answer.contact_chi2 > whole.contact_chi2 + 10.0


def untouched(lab, rng):
    command = lab.command(rng)
    theta = lab.within_the_statics(lab.parameters.drawn(rng))
    return command, lab.read(theta, command)


@pytest.mark.parametrize("channel", [0, 4, 11])
def test_a_wrong_channel_is_found_with_what_it_reads_too_much(lab, channel):
    rng = np.random.default_rng(3)
    command, reading = untouched(lab, rng)
    reading[channel] += 20.0
    answer = lab.answer(reading, command, *prior(lab))
    assert answer.faulty_evidence.argmax() == channel
    rivals = (answer.contact_evidence, answer.segment_evidence, answer.several_evidence)
    assert answer.faulty_evidence[channel] > max(np.max(each) for each in rivals)
    deviation = answer.information_n2[channel, channel] ** -0.5
    assert abs(answer.fault_n[channel] - 20.0) < 3.0 * deviation


def test_exchanged_channels_are_found(lab):
    """Readings are alike in a straight arm without weight: this one is bent and pushed down."""
    command = np.deg2rad([8.0, -6.0, 7.0, 5.0, -8.0, 6.0, 5.0, -7.0])
    mean, covariance = prior(lab)
    exact = lab.read(mean, command)
    apart = np.abs(exact[:, None] - exact)
    first, second = np.unravel_index(apart.argmax(), apart.shape)
    reading = exact.copy()
    reading[[first, second]] = exact[[second, first]]
    answer = lab.answer(reading, command, mean, covariance)
    found = np.unravel_index(answer.exchanged_evidence.argmax(), apart.shape)
    assert set(found) == {first, second}
    # exchanged back, nothing is left to explain
    gain = 0.5 * (answer.free_chi2 - lab.answer(exact, command, mean, covariance).free_chi2)
    assert answer.exchanged_evidence.max() == pytest.approx(gain, rel=0.05)


def test_two_pushes_at_once_are_not_one(lab):
    rng = np.random.default_rng(4)
    mean, covariance = prior(lab)
    pushes = [Push(1, 0.06, (0.0, 25.0, 0.0)), Push(3, 0.07, (0.0, 0.0, -20.0))]
    for _ in range(5):
        command = lab.command(rng)
        answer = lab.answer(lab.read(mean, command, pushes), command, mean, covariance)
        others = max(answer.several_evidence, answer.segment_evidence.max())
        assert others > answer.contact_evidence.max() + 10.0
        one = lab.answer(lab.read(mean, command, pushes[1:]), command, mean, covariance)
        assert one.contact_evidence.max() > one.several_evidence + 10.0


def test_evidences_of_wrenches_are_those_of_normal_distributions(lab):
    """They are log N(y; 0, S + L L') - log N(y; 0, S), for readings y and what is added to S."""
    rng = np.random.default_rng(5)
    mean, covariance = prior(lab)
    command = lab.command(rng)
    reading = lab.read(mean, command, [drawn_push(rng, [2])])
    answer = lab.answer(reading, command, mean, covariance)
    innovation = answer.innovation_n
    spread = np.linalg.inv(answer.information_n2)

    def log_density(covariance):
        _, logarithm = np.linalg.slogdet(covariance)
        return -0.5 * (innovation @ np.linalg.solve(covariance, innovation) + logarithm)

    channel = np.eye(12)[3][:, None]
    wrong = 20.0**2 * channel @ channel.T
    alone = log_density(spread + wrong) - log_density(spread)
    assert answer.faulty_evidence[3] == pytest.approx(alone, abs=1e-6)
    for segment in range(4):
        levers = np.concatenate([answer.at_joint_m[segment], answer.by_place[segment, 1:]])
        # forces of 100 N, and moments of these in mid-segment
        scale = np.array([100.0, 100.0, 100.0, 6.5, 6.5])
        seen = answer.by_torque @ levers.T * scale
        with_wrench = log_density(spread + seen @ seen.T) - log_density(spread)
        assert answer.segment_evidence[segment] == pytest.approx(with_wrench, abs=1e-6)
        both = log_density(spread + seen @ seen.T + wrong) - log_density(spread)
        assert answer.faulty_segment_evidence[3, segment] == pytest.approx(both, abs=1e-6)
