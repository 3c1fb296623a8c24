"""The search leaves saddles, crosses kinks and says what it could not finish."""

import numpy as np

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.rest_search import rounding_n_m, search_rest

SOFT = mechanism_of(open_arm("cdsm_lab"))


def rest_m(mechanism: Mechanism, command: np.ndarray) -> np.ndarray:
    stretch = mechanism.pretension_n / mechanism.stiffness_n_m
    return kinematics.spans(mechanism, command).length_m.sum(-1) - stretch


def test_few_steps_suffice_however_many_cables_go_slack() -> None:
    rng = np.random.default_rng(11)
    command = np.deg2rad(rng.uniform(-8, 8, (1000, 8)))
    segment, angle = rng.integers(1, 5, 1000), rng.uniform(0, 360, 1000)
    forces = normal_force_n(SOFT, command, segment, angle, rng.uniform(50, 150, 1000))
    angles, tensions, residual, steps = search_rest(
        SOFT, 1e-9, rest_m(SOFT, command), forces, command
    )
    assert np.isfinite(angles).all()
    assert ((tensions == 0).sum(axis=1) >= 3).any()
    assert residual.max() <= 1e-9
    assert steps.max() < 25
    assert np.median(steps) <= 6


def test_what_finds_no_stable_pose_keeps_a_residual() -> None:
    """A column with too little lateral stiffness buckles: cables this soft cannot hold it."""
    pretension = np.full(12, 1e4)
    weak = Mechanism(
        **{**vars(SOFT), "stiffness_n_m": np.full(12, 1e2), "pretension_n": pretension}
    )
    command = np.full((1, 8), 0.05)
    *_, residual, _ = search_rest(weak, 1e-9, rest_m(weak, command), np.zeros((1, 4, 3)), command)
    assert residual[0] > 1e-7


def test_rounding_stays_below_the_residual_asked_for_on_the_bundled_arms() -> None:
    for name in ("cdsm", "cdsm_lab", "cdsm_table2"):
        assert rounding_n_m(mechanism_of(open_arm(name))) < 1e-9
