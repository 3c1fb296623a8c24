"""The linear measurement: exact at the state of a reading, and with the derivatives it states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cablesense_sim.arm import open_arm
from cablesense_sim.parameter_groups import ParameterGroup
from cablesense_sim.tolerances import ArmParameters
from tests.helpers.arm_variants import five_by_four
from tests.helpers.law_arms import NOISE_STD_N, LawArm, Push, inferred_torque

SHARE_OF_TOLERANCES = {"cdsm_lab": 1.0, "cdsm": 0.02, "five_by_four": 1.0}
"""The shipped arm is a hundred times as stiff: whole tolerances slacken its cables."""


@pytest.fixture(scope="module", params=SHARE_OF_TOLERANCES)
def law(request):
    name = request.param
    return LawArm(five_by_four("cdsm_lab") if name == "five_by_four" else open_arm(name))


@pytest.fixture(scope="module")
def lab():
    return LawArm(open_arm("cdsm_lab"))


def drawn(law, rng):
    name = "five_by_four" if law.mechanism.segment_count == 5 else None
    stiff = law.mechanism.stiffness_n_m[0] > 1e6
    share = SHARE_OF_TOLERANCES[name or ("cdsm" if stiff else "cdsm_lab")]
    return share * law.within_the_statics(law.parameters.drawn(rng))


def test_readings_of_an_arm_that_is_known_show_the_torques_of_a_push(law):
    rng = np.random.default_rng(1)
    for _ in range(5):
        theta = drawn(law, rng)
        command = law.command(rng)
        push = Push(2, 0.08, (3.0, 10.0, -15.0))
        rest, torque = law.rest(theta, command, [push])
        answer = law.answer(law.read(theta, command, [push]), command, theta)
        np.testing.assert_allclose(answer.pose_rad, rest.joint_angles_rad, atol=1e-8)
        lever = answer.at_joint_m[2] + push.place_m * answer.by_place[2]
        np.testing.assert_allclose(np.array(push.force_n) @ lever, torque, atol=1e-8)
        np.testing.assert_allclose(inferred_torque(answer), torque, atol=1e-8)
        residual_n = answer.innovation_n - answer.by_torque @ torque
        np.testing.assert_allclose(residual_n, 0.0, atol=1e-7)


def test_so_do_readings_some_of_which_are_zero_as_their_cables_are_slack(lab):
    rng = np.random.default_rng(2)
    slack = []
    for _ in range(10):
        theta = drawn(lab, rng)
        command = lab.command(rng)
        rest, torque = lab.rest(theta, command, [Push(1, 0.1, (0.0, 55.0, -55.0))])
        slack.append((rest.tensions_n == 0.0).sum())
        answer = lab.answer(lab.parameters.read(theta, rest.tensions_n), command, theta)
        np.testing.assert_allclose(inferred_torque(answer), torque, atol=1e-6)
        residual_n = answer.innovation_n - answer.by_torque @ torque
        np.testing.assert_allclose(residual_n, 0.0, atol=1e-6)
    assert 1 <= max(slack) <= 4


def test_a_cable_that_reads_little_counts_once_its_zero_is_known():
    """Of stiff cables one that has a newton left is as taut as any other, whatever the noise."""
    law = LawArm(open_arm("cdsm"))
    rng = np.random.default_rng(7)
    nothing = np.zeros(len(law.parameters))
    command = np.zeros(law.mechanism.joint_count)
    nearly_slack = []
    for _ in range(600):
        size_n = rng.uniform(30.0, 200.0)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        across_n = (0.0, size_n * np.sin(angle), size_n * np.cos(angle))
        reading_n = law.read(nothing, command, [Push(int(rng.integers(1, 4)), 0.065, across_n)])
        if ((reading_n > 0.6) & (reading_n < 1.8)).any():
            nearly_slack.append(reading_n + rng.normal(0.0, NOISE_STD_N, len(reading_n)))
    assert len(nearly_slack) > 5
    chi2 = law.answer(nearly_slack, np.tile(command, (len(nearly_slack), 1)), nothing).contact_chi2
    assert chi2.max() < 40.0


def numeric_derivative(law, theta, command, pushes, by_torque):
    """G (M, P) by central differences of the equilibrium, at the same torques of the pushes."""
    std = law.parameters.prior_std
    stiffest = law.mechanism.stiffness_n_m.max()
    derivative = np.zeros((law.mechanism.cable_count, len(std)))
    for i in np.flatnonzero(law.within_the_statics(std)):
        step = np.zeros(len(std))
        step[i] = std[i] * min(0.05, 1e3 / stiffest)
        change = 0.0
        torque_change = 0.0
        for sign in (1.0, -1.0):
            rest, torque = law.rest(theta + sign * step, command, pushes)
            change = change + sign * law.parameters.read(theta + sign * step, rest.tensions_n)
            torque_change = torque_change + sign * torque
        derivative[:, i] = (change - by_torque @ torque_change) / (2.0 * step[i])
    return derivative


@pytest.mark.parametrize(
    "pushes", [(), (Push(2, 0.08, (3.0, 10.0, -15.0)),)], ids=["free", "push"]
)
def test_derivatives_by_parameters_are_those_of_the_equilibrium(law, pushes):
    """Those of lengths and joint zeros too, once the push's own torques are set apart."""
    rng = np.random.default_rng(3)
    theta = drawn(law, rng)
    command = law.command(rng)
    answer = law.answer(law.read(theta, command, pushes), command, theta)
    expected = numeric_derivative(law, theta, command, pushes, answer.by_torque)
    std = law.within_the_statics(law.parameters.prior_std)
    scaled = answer.by_parameter * std
    expected = expected * std
    scale = np.abs(expected).max(axis=0) + 1e-3 * np.abs(expected).max()
    assert (np.abs(scaled - expected) / scale).max() < 1e-3


def test_derivatives_by_torques_are_those_of_the_equilibrium(law):
    rng = np.random.default_rng(4)
    theta = drawn(law, rng)
    command = law.command(rng)
    force = np.array([3.0, 10.0, -15.0])
    answer = law.answer(law.read(theta, command, [Push(2, 0.08, tuple(force))]), command, theta)
    for axis in np.eye(3):
        step = 0.01 * axis
        above, torque_above = law.rest(theta, command, [Push(2, 0.08, tuple(force + step))])
        below, torque_below = law.rest(theta, command, [Push(2, 0.08, tuple(force - step))])
        read = law.parameters.read(theta, above.tensions_n)
        change = read - law.parameters.read(theta, below.tensions_n)
        expected = answer.by_torque @ (torque_above - torque_below)
        np.testing.assert_allclose(change, expected, atol=1e-4 * np.abs(change).max())


def untouched_reading(law, theta, command):
    """What the module itself expects of an untouched arm with friction."""
    reading = law.mechanism.pretension_n.copy()
    for _ in range(12):
        reading = reading - law.answer(reading, command, theta).innovation_n
    return reading


def test_derivatives_by_what_the_equilibrium_lacks_are_those_of_the_prediction():
    """In the limit of little friction.

    The pose of a reading is fitted with the compliance of a cable that does not rub, so what the
    derivatives are taken at is off by a share of the coefficient: 0.5 of it on this arm.
    """
    law = LawArm(open_arm("cdsm_lab"), wraps=(1.0, 0.1))
    rng = np.random.default_rng(5)
    theta = law.parameters.drawn(rng)
    theta[law.at("carried_friction")] *= 0.002 / theta[law.at("friction")]
    command = law.command(rng)
    reading = untouched_reading(law, theta, command)
    answer = law.answer(reading, command, theta)
    np.testing.assert_allclose(answer.innovation_n, 0.0, atol=1e-9)
    std = law.parameters.prior_std
    places = range(len(std))
    kinds = ("carried_friction", "run_compliance", "centre_across")
    lacking = [places[law.at(kind)] for kind in kinds]
    for i in (i for kind in lacking for i in kind if std[i]):
        step = np.zeros(len(std))
        step[i] = 1e-3 * std[i]
        above = law.answer(reading, command, theta + step).innovation_n
        below = law.answer(reading, command, theta - step).innovation_n
        expected = -(above - below) / (2.0 * step[i])
        given = answer.by_parameter[:, i]
        np.testing.assert_allclose(given, expected, atol=2e-3 * np.abs(expected).max())


def test_groups_of_parameters_may_stand_in_any_order(lab, monkeypatch):
    """The same arm with its groups turned around has the same answer, parameter by parameter."""
    rng = np.random.default_rng(8)
    theta = lab.parameters.drawn(rng)
    command = lab.command(rng)
    push = Push(2, 0.08, (3.0, 10.0, -15.0))
    reading = lab.read(lab.within_the_statics(theta), command, [push])
    expected = lab.answer(reading, command, theta)
    built = ArmParameters.__init__

    def turned_around(parameters, *given):
        built(parameters, *given)
        parameters.groups = parameters.groups[::-1]

    monkeypatch.setattr(ArmParameters, "__init__", turned_around)
    turned = LawArm(open_arm("cdsm_lab"))
    there = [turned.parameters.names.index(name) for name in lab.parameters.names]
    theta_turned = np.empty_like(theta)
    theta_turned[there] = theta
    answer = turned.answer(reading, command, theta_turned)
    assert there != list(range(len(there)))
    np.testing.assert_allclose(answer.by_parameter[:, there], expected.by_parameter, rtol=1e-9)
    np.testing.assert_allclose(answer.innovation_n, expected.innovation_n, rtol=1e-9)
    np.testing.assert_allclose(answer.by_torque, expected.by_torque, rtol=1e-9)


def test_a_group_that_the_graph_does_not_know_is_refused(monkeypatch):
    built = ArmParameters.__init__

    def with_another(parameters, *given):
        built(parameters, *given)
        parameters.groups = (ParameterGroup("twist", "rad", ("arm",), 0.1), *parameters.groups)

    monkeypatch.setattr(ArmParameters, "__init__", with_another)
    with pytest.raises(ValueError, match="twist"):
        LawArm(open_arm("cdsm_lab"))


def weightless(arm, wraps):
    law = LawArm(arm)
    return LawArm(arm, replace(law.mechanism, gravity_m_s2=np.zeros(3)), wraps=wraps)


@pytest.mark.parametrize("slide", [1.0, -0.5])
def test_a_pulley_carries_tension_over_as_the_capstan_equation_says(slide):
    """T_out = T_in exp(μθ): the straight arm's pretension, shared by what lies on either side."""
    wrap_rad = 1.2
    run = 0.5 / (1.0 + 0.5)  # of the compliance, before the pulley
    law = weightless(open_arm("cdsm_lab"), (wrap_rad, 0.0))
    theta = np.zeros(len(law.parameters))
    theta[law.at("carried_friction_0")] = 0.3 * slide
    ratio = np.exp(0.3 * slide * wrap_rad)
    # all cables of a segment are alike, so the arm stays straight
    expected = law.mechanism.pretension_n / (run + (1.0 - run) * ratio)
    answer = law.answer(expected, np.zeros(8), theta)
    np.testing.assert_allclose(answer.innovation_n, 0.0, atol=0.05)
    np.testing.assert_allclose(untouched_reading(law, theta, np.zeros(8)), expected, rtol=1e-3)


def test_a_push_is_weighed_by_the_tensions_behind_the_pulley():
    """The same push, read before a pulley that each cable slides over: T_in = T_out exp(-μθ).

    What the run then stretches less, each cable was pretensioned less.
    """
    law = weightless(open_arm("cdsm_lab"), (1.2, 0.0))
    command = np.zeros(8)
    nominal = np.zeros(len(law.parameters))
    rest, torque = law.rest(nominal, command, [Push(2, 0.08, (0.0, 10.0, -15.0))])
    ratio = np.exp(0.1 * 1.2)
    reading = rest.tensions_n / ratio
    run = 0.5 / (1.0 + 0.5)  # of the compliance, before the pulley
    theta = nominal.copy()
    theta[law.at("carried_friction_0")] = 0.1
    theta[law.at("pretension")] = run * (reading - rest.tensions_n)
    inferred = inferred_torque(law.answer(reading, command, theta))
    np.testing.assert_allclose(inferred, torque, atol=2e-3 * np.abs(torque).max())


def test_innovations_of_drawn_arms_are_chi_square(lab):
    """Their covariance S is that of tolerances and noise: normalised squares have the mean M."""
    rng = np.random.default_rng(6)
    std = lab.within_the_statics(lab.parameters.prior_std)
    count = 200
    commands = np.stack([lab.command(rng) for _ in range(count)])
    readings = []
    for command in commands:
        exact = lab.read(lab.within_the_statics(lab.parameters.drawn(rng)), command)
        readings.append(exact + rng.normal(0.0, NOISE_STD_N, len(exact)))
    answer = lab.answer(np.array(readings), commands, np.zeros(len(std)), np.diag(std**2))
    cables = lab.mechanism.cable_count
    deviation = np.sqrt(2.0 * cables / count)
    assert abs(answer.free_chi2.mean() - cables) < 3.0 * deviation


@pytest.mark.parametrize("share", [0.0, 1.0], ids=["known", "uncertain"])
def test_no_reading_makes_an_answer_that_is_no_number(lab, share):
    rng = np.random.default_rng(7)
    readings = np.concatenate(
        [
            np.zeros((1, 12)),
            np.full((1, 12), 1e-3),
            np.full((1, 12), 1e4),
            np.eye(12) * 50.0,
            50.0 - np.eye(12) * 50.0,
            rng.uniform(0.0, 500.0, (200, 12)),
            rng.uniform(0.0, 500.0, (200, 12)) * (rng.random((200, 12)) < 0.5),
        ]
    )
    commands = np.stack([lab.command(rng) for _ in readings])
    covariance = np.diag((share * lab.parameters.prior_std) ** 2)
    answer = lab.answer(readings, commands, lab.parameters.prior_mean, covariance)
    for name, value in vars(answer).items():
        assert np.isfinite(value).all(), name
