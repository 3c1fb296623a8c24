"""Uncertain parameters of an arm as terms of its diagnosis, and what a recording says of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablesense_gap.arm_nuisance import fitted_parameters, terms_of, tolerance_candidates
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.arm_system import ArmSystem
from cablesense_gap.diagnosis.fitting import refine
from cablesense_gap.diagnosis.nuisance_posterior import nuisance_posterior
from cablesense_gap.simulator import parameters_of, predicted_changes
from cablesense_gap.system import problem_of
from cablesense_sim.arm import open_arm
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.replay import read_tensions_n
from cablesense_sim.tolerances import Tolerances
from cablesense_sim.uncertain_arm import arm_parameters
from tests.helpers.expected_parameters import expected_parameters
from tests.helpers.gap_recordings import LAB, small_recording

BUILT = open_arm("cdsm_lab")
PARAMETERS = arm_parameters(BUILT)
FEW = np.r_[0:4, 20:56:3, 164:200:3, 308:368:5]
RECORDING = small_recording(peak_n=25.0).rows(FEW)
RECORDING = replace(RECORDING, time_s=0.2 * np.arange(len(FEW)))


def drawn(seed: int) -> np.ndarray:
    """Deviations (P,) of everything that has a term."""
    theta = PARAMETERS.drawn(np.random.default_rng(seed))
    theta[[term is None for term in terms_of(PARAMETERS)]] = 0.0
    return theta


def as_terms(theta: np.ndarray) -> dict:
    """The same as values of terms."""
    each = zip(terms_of(PARAMETERS), theta.tolist(), strict=True)
    return {term: value for term, value in each if term is not None and value}


def test_everything_that_a_diagnosis_can_simulate_has_a_term_of_its_own():
    terms = terms_of(PARAMETERS)
    each = zip(PARAMETERS.names, terms, strict=True)
    nameless = {name.split(" of ")[0] for name, term in each if term is None}
    carried = {f"carried_friction_{n}" for n in range(5)}
    assert nameless == carried | {"friction", "run_compliance", "centre_across"}
    named = [term for term in terms if term]
    assert len(set(named)) == len(named)
    offered = parameters_of(tolerance_candidates(BUILT))
    std = dict(zip(terms, PARAMETERS.prior_std, strict=True))
    for term, parameter in offered.items():
        if term.parameter not in ("contact_m", "friction_share"):
            assert parameter.typical == std[term]
        assert parameter.low <= -10.0 * parameter.typical or parameter.low == -0.9
    # holes that a cable does not have are no candidates
    assert {t for t in named if std[t] > 0.0} <= offered.keys()
    assert not {t for t in named if std[t] == 0.0} & offered.keys()


def test_the_terms_do_to_an_arm_what_the_parameters_do():
    theta = drawn(1)
    mechanism = PARAMETERS.built(theta)
    held_m = held_lengths_m(
        PARAMETERS.built(0.0 * theta), RECORDING.command_rad + PARAMETERS.joint_zeros_rad(theta)
    )
    rest = solve_equilibrium(mechanism, RECORDING.command_rad, RECORDING.forces_n, held_m=held_m)
    (read_n,) = ArmSimulator(BUILT, RECORDING).predict([as_terms(theta)])
    assert_allclose(read_n, PARAMETERS.read(theta, rest.tensions_n), atol=1e-4)


def test_tolerances_of_zero_are_left_out():
    exact = BUILT.model_copy(update={"tolerances": Tolerances().scaled(0.0)})
    assert tolerance_candidates(exact) == ()
    effects = {candidate.effect for candidate in tolerance_candidates(LAB)}
    assert effects == {
        "cable_tolerance",
        "hole_tolerance",
        "segment_tolerance",
        "sensor_tolerance",
    }


def test_small_changes_are_those_of_the_search_for_rests():
    simulator = ArmSimulator(BUILT, RECORDING)
    base = as_terms(0.5 * drawn(2))
    std = {t: p.typical for t, p in parameters_of(simulator.tolerances).items()}
    variants = [{**base, t: base.get(t, 0.0) + 1e-3 * s} for t, s in std.items()]
    base = {**dict.fromkeys(std, 0.0), **base}
    variants = [{**base, **variant} for variant in variants]
    changes_n = simulator.small_changes(base, variants)
    searched = predicted_changes(simulator, base, variants)
    assert_allclose(changes_n, searched, atol=0.01 * np.abs(searched).max())


@pytest.fixture(scope="module")
def known():
    """Of three arms: the true deviations, and the parameters after a recording of nothing else."""
    posteriors = []
    for seed in range(3):
        theta = drawn(seed)
        recording = small_recording(peak_n=25.0)
        (ideal_n,) = ArmSimulator(BUILT, recording).predict([as_terms(theta)])
        read_n = read_tensions_n(ideal_n, BUILT.sensors, np.random.default_rng([seed, 1]))
        problem = problem_of(ArmSystem(BUILT, replace(recording, tensions_n=read_n)))
        without_effects = refine(problem, {}, [[]])
        assert without_effects.held_out_rmse < 1.1 * problem.floor
        assert problem.nuisance_mix.shape[1] < problem.nuisance_mix.shape[0]
        posterior = nuisance_posterior(problem, without_effects)
        posteriors.append((theta, fitted_parameters(BUILT, BUILT, posterior)))
    return posteriors


@pytest.mark.slow
def test_a_recording_says_of_parameters_what_it_can_and_how_sure_it_is(known):
    prior = expected_parameters(BUILT)
    assert prior.names == tuple(PARAMETERS.names)
    assert_allclose(prior.mean, PARAMETERS.prior_mean)
    assert_allclose(np.sqrt(prior.covariance.diagonal()), PARAMETERS.prior_std)
    has_term = np.array([term is not None for term in terms_of(PARAMETERS)])
    off = []
    for theta, parameters in known:
        std = np.sqrt(parameters.covariance.diagonal())
        assert (std <= PARAMETERS.prior_std + 1e-12).all()
        assert_allclose(std[~has_term], PARAMETERS.prior_std[~has_term])
        uncertain = has_term & (PARAMETERS.prior_std > 0.0)
        off.append((parameters.mean - theta)[uncertain] / std[uncertain])
        gains = PARAMETERS.slices["sensor_gain"]
        assert np.median(std[gains]) < 0.8 * PARAMETERS.prior_std[gains].mean()
    size = np.sqrt(np.mean(np.square(off)))
    assert 0.8 < size < 1.2


@pytest.mark.slow
def test_with_what_is_known_of_it_an_arm_reads_as_it_does(known):
    """Poses and loads that were not recorded, though not far from those."""
    course = replace(small_recording(peak_n=15.0).rows(FEW), time_s=RECORDING.time_s)
    course = replace(course, command_rad=0.7 * course.command_rad)
    simulator = ArmSimulator(BUILT, course)
    (nominal_n,) = simulator.predict([{}])
    for theta, parameters in known:
        true_n, known_n = simulator.predict([as_terms(theta), as_terms(parameters.mean)])
        before_n, after_n = (
            np.sqrt(((true_n - each) ** 2).mean()) for each in (nominal_n, known_n)
        )
        assert before_n > 8.0 * simulator.floor
        assert after_n < 0.3 * simulator.floor
