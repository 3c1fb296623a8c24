"""To second order in its give, a stiff arm's statics say what the repeated closed form says."""

import numpy as np
import pytest
import torch

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.networks.closed_form import ClosedForm
from cablesense_training.networks.second_order import SecondOrderClosedForm

pytestmark = pytest.mark.slow


VARIANCE_N2 = 0.005
BARELY_TAUT_N = 0.3
"""Tensions below this pass for none, at that variance."""

CDSM = mechanism_of(open_arm("cdsm"))
ROWS = 600


def _second_order():
    return SecondOrderClosedForm(ClosedForm(CDSM, VARIANCE_N2, pose_corrections=1))


def _weighed(closed_form, tension_difference_n, command_rad):
    """Candidates whose evidence (B, N) is the misfit that each explains."""
    with torch.no_grad():
        found = closed_form.weigh(
            torch.as_tensor(tension_difference_n),
            torch.as_tensor(command_rad),
            lambda information, covariance_n2: (information, 0.0 * covariance_n2[..., 0, 0]),
        )
    found = found._replace(evidence=found.evidence[:, 0])
    return type(found)(*(part.numpy() for part in found))


def _tensions(command, segment, angle_deg, magnitude_n):
    """Noise-free tensions under load and without."""
    forces = normal_force_n(CDSM, command, segment, angle_deg, magnitude_n)
    loaded = solve_equilibrium(CDSM, command, forces).tensions_n
    return loaded, solve_equilibrium(CDSM, command).tensions_n


@pytest.fixture(scope="module", params=[0.0, 10.0], ids=["straight", "random poses"])
def pushes(request):
    """Commands, segments, forces, tension differences and which cables are slack; none barely."""
    rng = np.random.default_rng(1)
    reach = np.deg2rad(request.param)
    command = rng.uniform(-reach, reach, (ROWS, CDSM.joint_count))
    segment = rng.integers(1, CDSM.segment_count + 1, ROWS)
    angle_deg, magnitude = rng.uniform(0.0, 360.0, ROWS), rng.uniform(1.0, 200.0, ROWS)
    loaded, unloaded = _tensions(command, segment, angle_deg, magnitude)
    slack = loaded == 0.0
    # as many taut cables as joint angles determine the pose
    known = slack.sum(axis=1) <= CDSM.cable_count - CDSM.joint_count
    known &= ~((loaded > 0.0) & (loaded < BARELY_TAUT_N)).any(axis=1)
    assert known.sum() > 0.95 * ROWS
    assert slack[known].any(axis=1).mean() > 0.5
    theta = np.deg2rad(angle_deg)
    force = magnitude[:, None] * np.stack([np.sin(theta), np.cos(theta)], axis=1)
    return tuple(part[known] for part in (command, segment, force, loaded - unloaded, slack))


def test_it_agrees_with_the_closed_form_at_the_true_pose_slack_or_not(pushes):
    command, segment, force, difference, slack = pushes
    found = _weighed(_second_order(), difference, command)
    exact = _weighed(ClosedForm(CDSM, VARIANCE_N2, pose_corrections=2), difference, command)
    np.testing.assert_array_equal(found.taut == 0.0, slack)
    np.testing.assert_array_equal(found.evidence.argmax(axis=1) + 1, segment)
    own = np.arange(len(segment)), segment - 1
    for other in (exact.force_n[own], force):
        error = np.hypot(*(found.force_n[own] - other).T)
        assert np.median(error) < 0.002
        assert error.max() < 0.01
    np.testing.assert_allclose(found.evidence[own], exact.evidence[own], rtol=0.05)
    for axis in (0, 1):
        np.testing.assert_allclose(
            found.covariance_n2[*own, axis, axis], exact.covariance_n2[*own, axis, axis], rtol=0.01
        )


@pytest.mark.parametrize("magnitude_n", [10.0, 150.0], ids=["all taut", "some slack"])
def test_covariance_is_that_of_the_estimates_over_many_readings(magnitude_n):
    rng = np.random.default_rng(2)
    command = rng.uniform(-0.17, 0.17, (1, CDSM.joint_count))
    loaded, unloaded = _tensions(command, 4, [40.0], [magnitude_n])
    assert not ((loaded > 0.0) & (loaded < 1.0)).any()
    assert (loaded == 0.0).any() == (magnitude_n > 100.0)
    noise = rng.normal(0.0, VARIANCE_N2**0.5, (3000, CDSM.cable_count))
    read = np.where(loaded > 0.0, loaded + noise, 0.0) - unloaded
    found = _weighed(
        _second_order(),
        read,
        np.repeat(command, 3000, axis=0),
    )
    own = found.force_n[:, 3]
    stated = found.covariance_n2[:, 3].mean(axis=0)
    whitened = np.linalg.solve(np.linalg.cholesky(stated), (own - own.mean(axis=0)).T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(2), atol=0.12)
