"""The noise bound agrees with analysis, scales with noise, and is attained where it should be."""

import numpy as np
import pytest

from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.evaluation.law import BoundedErrors, exact_calibration
from cablesense_training.evaluation.metrics import force_covariance_n2, noise_bound
from cablesense_training.evaluation.points import point_answer
from cablesense_training.law.build import TorchLaw

CDSM = open_arm("cdsm")


def _arm(base=CDSM, **sensors):
    content = base.model_dump()
    content["sensors"] |= sensors
    return Arm.model_validate(content)


def _dataset(arm, samples=400, **options):
    options = {"no_contact_fraction": 0.0, **options}
    return draw_dataset(arm, SingleContact(samples=samples, **options), seed=3)


def test_one_segment_of_equal_cables_has_an_analytic_bound():
    # three cables at radius r, 120 degrees apart, share the moment F c about the joint: the
    # tensions change by 2 F c cos(angle to the cable) / (3 r), hence C = 3 v r^2 / (2 c^2) I
    content = CDSM.model_dump()
    content["segments"]["count"] = 1
    content["segments"]["mass_kg"] = 0.0
    content["cables"]["stiffness_n_m"] = 1e9
    content["actuators"]["kp_n_m"] = 1e10
    arm = Arm.model_validate(content)
    dataset = _dataset(arm, samples=30, force_high_n=10.0)
    mechanism = mechanism_of(arm)
    radius = np.hypot(mechanism.hole_y_m, mechanism.hole_z_m)[0]
    contact = mechanism.contact_m[0]
    variance = difference_variance_n2(arm.sensors, dataset.protocol.tare_samples)
    expected = 1.5 * variance * (radius / contact) ** 2 * np.eye(2)
    covariance_n2 = force_covariance_n2(dataset)[:, 0]
    np.testing.assert_allclose(covariance_n2 - expected, 0.0, atol=1e-3 * expected[0, 0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cdsm", "cdsm_lab"])
def test_the_law_attains_the_bound_while_all_cables_are_taut(name):
    arm = _arm(open_arm(name), noise_std_n=0.05, step_n=0.0)
    dataset = _dataset(arm, samples=2500, pose="random", force_low_n=2.0, force_high_n=15.0)
    dataset = dataset.select(dataset.slack_cables == 0)
    assert len(dataset) > 2250
    # no tare is taken from the readings, whose noise is all there is
    answer = point_answer(
        TorchLaw(arm),
        exact_calibration(arm),
        dataset.unloaded_n + dataset.tension_difference_n,
        dataset.command_rad,
        mechanism_of(arm).contact_m,
        15.0,
    )
    right = answer.segment == dataset.segment
    assert right.mean() > 0.99
    error = answer.magnitude_n - dataset.magnitude_n
    bound = noise_bound(dataset)
    assert np.sqrt((error[right] ** 2).mean()) == pytest.approx(bound.magnitude_rmse_n, rel=0.08)
    assert np.abs(error[right]).mean() == pytest.approx(bound.magnitude_mae_n, rel=0.08)


def test_errors_without_a_bound_are_not_compared_with_it():
    error = np.array([1.0, -5.0, 3.0])
    bound = np.array([0.5, 0.0, 1.0])
    known = bound > 0.0
    assert BoundedErrors.of(error, bound) == BoundedErrors.of(error[known], bound[known])
    assert np.isnan(BoundedErrors.of(error[~known], bound[~known]).rms)
