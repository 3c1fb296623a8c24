"""Statics alone recovers contacts exactly without noise, and states its errors truly with it."""

from typing import NamedTuple

import numpy as np
import pytest
import torch
from scipy import stats

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.networks.closed_form import ClosedForm, NearCommand, pose_corrections_for

VARIANCE_N2 = 0.005
BARELY_TAUT_N = 0.3
"""Tensions below this pass for none, at that variance."""


def _mechanism(name):
    return mechanism_of(open_arm(name))


def _closed_form(mechanism, variance_n2=VARIANCE_N2):
    return ClosedForm(mechanism, variance_n2, max(2, pose_corrections_for(mechanism)))


def _both(mechanism):
    """The closed form, and on a stiff arm the one that is expanded near the command."""
    exact = [_closed_form(mechanism)]
    stiff = pose_corrections_for(mechanism) <= 1
    return exact + [NearCommand(mechanism, VARIANCE_N2, 2)] * stiff


def _tensor(values):
    return torch.as_tensor(np.ascontiguousarray(values))


class Found(NamedTuple):
    """Forces by statics with their covariance, chi² of none, that explained, and taut cables."""

    force_n: np.ndarray
    covariance_n2: np.ndarray
    misfit_none: np.ndarray
    explained: np.ndarray
    taut: np.ndarray


def _candidates(closed_form, tension_difference_n, command_rad):
    with torch.no_grad():
        balance = closed_form(_tensor(tension_difference_n), _tensor(command_rad))
        found = closed_form.candidates(balance)
        torque = balance.torque_n_m
        misfit = torch.einsum("bi,bij,bj->b", torque, balance.precision, torque)
    parts = (found.force_n, found.covariance_n2, misfit, found.explained, balance.taut)
    return Found(*(part.numpy() for part in parts))


def _tensions(mechanism, command, segment, angle_deg, magnitude_n):
    """Noise-free tensions under load and without."""
    forces = normal_force_n(mechanism, command, segment, angle_deg, magnitude_n)
    loaded = solve_equilibrium(mechanism, command, forces).tensions_n
    return loaded, solve_equilibrium(mechanism, command).tensions_n


def _cases(mechanism, rows, reach_deg, seed=0):
    rng = np.random.default_rng(seed)
    reach = np.deg2rad(reach_deg)
    command = rng.uniform(-reach, reach, (rows, mechanism.joint_count))
    segment = rng.integers(1, mechanism.segment_count + 1, rows)
    return command, segment, rng.uniform(0.0, 360.0, rows), rng.uniform(1.0, 200.0, rows)


@pytest.mark.parametrize("reach_deg", [0.0, 10.0])
@pytest.mark.parametrize("arm", ["cdsm", "cdsm_lab", "cdsm_table2"])
def test_without_noise_segment_and_force_are_recovered_slack_or_not(arm, reach_deg):
    mechanism = _mechanism(arm)
    command, segment, angle_deg, magnitude = _cases(mechanism, 400, reach_deg)
    loaded, unloaded = _tensions(mechanism, command, segment, angle_deg, magnitude)
    slack = (loaded == 0.0).sum(axis=1)
    # as many taut cables as joint angles determine the pose
    known = slack <= mechanism.cable_count - mechanism.joint_count
    known &= ~((loaded > 0.0) & (loaded < BARELY_TAUT_N)).any(axis=1)
    assert known.sum() > 350
    assert (slack[known] > 0).sum() > 50
    theta = np.deg2rad(angle_deg)
    force = magnitude[:, None] * np.stack([np.sin(theta), np.cos(theta)], axis=1)
    for statics in _both(mechanism):
        found = _candidates(statics, loaded - unloaded, command)
        np.testing.assert_array_equal(found.explained.argmax(axis=1)[known] + 1, segment[known])
        np.testing.assert_array_equal((found.taut == 0.0).sum(axis=1)[known], slack[known])
        error = np.hypot(*(found.force_n[np.arange(len(segment)), segment - 1] - force).T)
        assert np.median(error[known]) < 0.01
        assert np.quantile(error[known], 0.98) < 0.1
        all_taut = 0.002 if isinstance(statics, NearCommand) else 1e-4
        assert error[known & (slack == 0)].max() < all_taut


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arm", "segment", "size_n"),
    [("cdsm", 1, 10.0), ("cdsm", 4, 150.0), ("cdsm_lab", 1, 10.0), ("cdsm_lab", 4, 10.0)],
)
def test_covariance_is_that_of_the_estimates_over_many_readings(arm, segment, size_n):
    mechanism = _mechanism(arm)
    rng = np.random.default_rng(2)
    command = rng.uniform(-0.17, 0.17, (1, mechanism.joint_count))
    loaded, unloaded = _tensions(mechanism, command, segment, [40.0], [size_n])
    assert not ((loaded > 0.0) & (loaded < 1.0)).any()
    assert (loaded == 0.0).any() == (size_n > 100.0)
    noise = rng.normal(0.0, VARIANCE_N2**0.5, (3000, mechanism.cable_count))
    read = np.where(loaded > 0.0, loaded + noise, 0.0) - unloaded
    for statics in _both(mechanism):
        found = _candidates(statics, read, np.repeat(command, 3000, axis=0))
        own = found.force_n[:, segment - 1]
        stated = found.covariance_n2[:, segment - 1].mean(axis=0)
        whitened = np.linalg.solve(np.linalg.cholesky(stated), (own - own.mean(axis=0)).T)
        np.testing.assert_allclose(np.cov(whitened), np.eye(2), atol=0.12)


def test_what_a_contact_explains_leaves_chi_squared_of_two_degrees_less():
    mechanism = _mechanism("cdsm")
    rng = np.random.default_rng(3)
    command = np.zeros((4000, mechanism.joint_count))
    loaded, unloaded = _tensions(mechanism, command[:1], 2, [100.0], [12.0])
    read = loaded - unloaded + rng.normal(0.0, VARIANCE_N2**0.5, (4000, mechanism.cable_count))
    found = _candidates(_closed_form(mechanism), read, command)
    left = found.misfit_none - found.explained[:, 1]
    assert stats.kstest(left, stats.chi2(6).cdf).pvalue > 1e-3
    assert (found.explained <= found.misfit_none[:, None] * (1.0 + 1e-9)).all()
