"""One sample at a time says what a batch says, whatever came before."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.inference.estimator import OUTPUTS
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.session import COMMAND, TAUT, TENSION, ModelSession
from cablesense_training.inference.single_run import SingleRun

CDSM = open_arm("cdsm")
POSES, PUSHES = 3, 12


@pytest.fixture(scope="module")
def session():
    session = ModelSession.open(find_model("cdsm"), OUTPUTS, CDSM)
    assert TAUT in session.beside
    return session


@pytest.fixture(scope="module")
def single(session):
    return SingleRun(session)


@pytest.fixture(scope="module")
def readings():
    """Commands (POSES, 8) and differences (POSES, PUSHES, 12) of pushes that slacken many sets."""
    mechanism = mechanism_of(CDSM)
    rng = np.random.default_rng(0)
    commands = rng.uniform(-0.17, 0.17, (POSES, 1, 8))
    forces = normal_force_n(
        mechanism,
        np.broadcast_to(commands, (POSES, PUSHES, 8)),
        rng.integers(1, 5, (POSES, PUSHES)),
        rng.uniform(0.0, 360.0, (POSES, PUSHES)),
        rng.uniform(5.0, 200.0, (POSES, PUSHES)),
    )
    loaded = solve_equilibrium(mechanism, commands, forces).tensions_n
    assert len({tuple(row) for row in (loaded == 0.0).reshape(-1, 12)}) > 10
    return commands[:, 0], loaded - solve_equilibrium(mechanism, commands).tensions_n


@pytest.fixture(scope="module")
def expected(session, readings):
    """The whole graph's outputs for every pose and push."""
    commands, differences = readings
    return [
        session.run({TENSION: pushes, COMMAND: np.repeat(command[None], PUSHES, axis=0)})
        for command, pushes in zip(commands, differences, strict=True)
    ]


asked = st.lists(
    st.tuples(st.integers(0, POSES - 1), st.integers(0, PUSHES - 1)), min_size=1, max_size=12
)


@settings(max_examples=30, deadline=None)
@given(asked=asked)
def test_an_answer_does_not_depend_on_which_cables_were_slack_before(
    single, readings, expected, asked
):
    commands, differences = readings
    last = None
    for pose, push in asked:
        if pose != last:
            single.set_command(commands[pose][None])
            last = pose
        single.tension_difference_n[:] = differences[pose, push]
        single.run()
        for name, said, whole in zip(OUTPUTS, single.outputs, expected[pose], strict=True):
            np.testing.assert_allclose(said, whole[push], rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.slow
def test_the_very_first_answer_is_right(session, readings, expected):
    commands, differences = readings
    for push in range(PUSHES):
        fresh = SingleRun(session)
        fresh.set_command(commands[0][None])
        fresh.tension_difference_n[:] = differences[0, push]
        fresh.run()
        for said, whole in zip(fresh.outputs, expected[0], strict=True):
            np.testing.assert_allclose(said, whole[push], rtol=1e-9, atol=1e-9)


def test_a_model_of_tensions_alone_runs_without_a_command(readings):
    session = ModelSession.open(find_model("cdsm_tensions_only"), OUTPUTS, CDSM)
    single = SingleRun(session)
    _, differences = readings
    whole = session.run({TENSION: differences[0]})
    for push in range(PUSHES):
        single.tension_difference_n[:] = differences[0, push]
        single.run()
        for said, all_rows in zip(single.outputs, whole, strict=True):
            np.testing.assert_allclose(said, all_rows[push], rtol=1e-9, atol=1e-9)
