"""Every answer in Python states its doubt: what fits no force, and what is out of range."""

import numpy as np
import pytest

from cablesense_contact import (
    Calibrator,
    ContactState,
    EstimateError,
    Estimator,
    Judge,
    LawModel,
    find_model,
)
from cablesense_contact.felt_arm import FeltArm
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n

ARM = open_arm("cdsm")
MECHANISM = mechanism_of(ARM)
STRAIGHT = np.zeros(ARM.joint_count)
SEGMENT = np.tile(np.arange(1, 5), 10)
ANGLE_DEG = np.linspace(0.0, 350.0, 40)
SIZE_N = np.linspace(5.0, 150.0, 40)


@pytest.fixture(scope="module")
def network():
    return Estimator.load(find_model("peers/cdsm_straight_two_stage"), ARM)


@pytest.fixture(scope="module")
def law():
    return LawModel(find_model("cdsm_anywhere"), ARM)


def pushed_n() -> tuple[np.ndarray, np.ndarray]:
    commands = np.tile(STRAIGHT, (40, 1))
    forces = normal_force_n(MECHANISM, commands, SEGMENT, ANGLE_DEG, SIZE_N)
    free = solve_equilibrium(MECHANISM, commands).tensions_n
    return free, solve_equilibrium(MECHANISM, commands, forces).tensions_n


def test_differences_that_no_force_makes_are_implausible(network):
    rng = np.random.default_rng(7)
    random = network.estimate_batch(rng.uniform(-30.0, 30.0, (200, 12)))
    assert random.plausible.mean() < 0.05
    assert np.median(random.misfit_n) > 5.0
    assert not network.estimate(rng.uniform(-30.0, 30.0, 12)).plausible
    free_n, push_n = pushed_n()
    pushed = network.estimate_batch(push_n - free_n)
    assert pushed.plausible.all()
    assert (pushed.low_n <= pushed.high_n).all()


def test_a_batch_of_judgements_states_all_that_single_ones_do(law):
    free_n, push_n = pushed_n()
    rng = np.random.default_rng(3)
    readings_n = np.concatenate([free_n[:5], push_n, 50.0 + rng.uniform(-30.0, 30.0, (20, 12))])
    commands = np.tile(STRAIGHT, (len(readings_n), 1))
    known = Calibrator(FeltArm(ARM), law).by_tolerances()
    still = np.zeros((ARM.joint_count, ARM.joint_count))
    seen = law(readings_n, commands, known.mean, known.covariance, still)
    judge = Judge(FeltArm(ARM))
    batch = judge.batch(seen, readings_n)
    for row, reading_n in enumerate(readings_n):
        single = judge(seen.row(row), reading_n)
        assert batch.state[row] is single.state
        assert batch.doubt[row] == single.doubt
        assert batch.force_known[row] == single.force_known
        assert batch.misfit[row] == single.misfit
    noise = batch.state[45:]
    vouched = [state in (ContactState.CONTACT, ContactState.MOMENT) for state in noise]
    assert not any(vouched)


def test_angles_in_degrees_are_refused(law):
    pose_aware = Estimator.load(find_model("peers/cdsm_two_stage"), ARM)
    reading_n = np.full((1, 12), 50.0)
    degrees = np.full((1, 8), 30.0)
    known = Calibrator(FeltArm(ARM), law).by_tolerances()
    still = np.zeros((8, 8))
    with pytest.raises(EstimateError, match="30 rad is more than half a turn"):
        law(reading_n, degrees, known.mean, known.covariance, still)
    with pytest.raises(EstimateError, match="30 rad is more than half a turn"):
        pose_aware.estimate(np.zeros(12), degrees[0])
    with pytest.raises(EstimateError, match="readings must be finite"):
        law(np.nan * reading_n, np.zeros((1, 8)), known.mean, known.covariance, still)
