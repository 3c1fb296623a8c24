"""Arms as a workshop may have built them: the same of a seed, within the file's tolerances."""

import numpy as np
import pytest

from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.built import BuiltArm, Workmanship
from cablesense_sim.arm import find_arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.built_arm import as_described, built_arm, unloaded_scatter_n
from cablesense_sim.dynamics import ArmDynamics, ArmQuasiStatics, moving_arm
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.tolerances import Tolerances
from tests.helpers.arm_variants import variant

ARM = open_arm("cdsm_lab")
NOMINAL = mechanism_of(ARM)
BENT = np.deg2rad([4.0, -5.0, 3.0, 6.0, -4.0, 2.0, 5.0, -3.0])


def test_a_seed_always_builds_the_same_arm_and_another_seed_another():
    first = built_arm(ARM, 7)
    again = built_arm(ARM, 7)
    other = built_arm(ARM, 8)
    np.testing.assert_array_equal(first.mechanism.mass_kg, again.mechanism.mass_kg)
    np.testing.assert_array_equal(first.sensor_gain, again.sensor_gain)
    assert (first.mechanism.mass_kg != other.mechanism.mass_kg).all()


def test_deviations_are_as_large_as_the_tolerances():
    arms = [built_arm(ARM, seed) for seed in range(40)]
    given = ARM.tolerances
    for values, std in (
        ([arm.sensor_gain for arm in arms], given.sensor_gain_share),
        ([arm.sensor_zero_n for arm in arms], given.sensor_zero_n),
        ([arm.joint_zeros_rad for arm in arms], np.deg2rad(given.joint_zero_deg)),
        ([arm.mechanism.pretension_n - 50.0 for arm in arms], given.pretension_n),
        ([arm.mechanism.mass_kg / 0.5 - 1.0 for arm in arms], given.segment_mass_share),
    ):
        assert np.std(values) == pytest.approx(std, rel=0.2)


def test_an_arm_without_tolerances_equals_its_file():
    exact = variant({"tolerances": Tolerances().scaled(0.0).model_dump()}, "cdsm_lab")
    built = built_arm(exact, 3)
    drawn = as_described(exact)
    np.testing.assert_allclose(built.mechanism.stiffness_n_m, drawn.mechanism.stiffness_n_m)
    np.testing.assert_allclose(built.mechanism.hole_y_m, drawn.mechanism.hole_y_m)
    tensions_n = np.linspace(10.0, 90.0, 12)
    np.testing.assert_array_equal(built.read(tensions_n), tensions_n)
    assert not built.joint_zeros_rad.any()


@pytest.mark.parametrize("name", ["cdsm", "cdsm_lab"])
def test_the_moving_arm_rests_where_statics_says_of_the_built_one(name):
    """Commanded lengths are those of the file, and the joint zeros are in them."""
    arm = open_arm(name)
    built = built_arm(arm, 7)
    command = BENT if name == "cdsm_lab" else np.zeros(8)
    moving = ArmDynamics(arm, built=built)
    moving.reset(command)
    moving.settle(1e-7)
    held_m = held_lengths_m(mechanism_of(arm), command + built.joint_zeros_rad)
    rest = solve_equilibrium(built.mechanism, command, held_m=held_m)
    np.testing.assert_allclose(moving.tensions_n, rest.tensions_n, atol=2e-3)
    exact = solve_equilibrium(mechanism_of(arm), command)
    assert np.abs(rest.tensions_n - exact.tensions_n).max() > 1.0
    assert np.abs(rest.joint_angles_rad - exact.joint_angles_rad).max() > np.deg2rad(0.1)


def test_listed_friction_has_a_coefficient_of_its_own():
    friction = {"effect": "capstan_friction", "at": "arm", "parameters": {"coefficient": 0.15}}
    arm = variant({"effects": [friction]}, "cdsm_lab")
    coefficients = [built_arm(arm, seed).entries[0].values["coefficient"] for seed in range(30)]
    assert np.mean(coefficients) == pytest.approx(0.15, rel=0.2)
    share = ARM.tolerances.friction_share
    assert np.std(coefficients) == pytest.approx(0.15 * share, rel=0.4)
    moving = moving_arm(arm, 1e-3, built_arm(arm, 2))
    assert isinstance(moving, ArmQuasiStatics)
    assert np.isfinite(moving.tensions_n).all()


def test_arms_scatter_with_their_tolerances():
    exact = ARM.model_copy(update={"tolerances": ARM.tolerances.scaled(0.0)})
    twice = ARM.model_copy(update={"tolerances": ARM.tolerances.scaled(2.0)})
    assert unloaded_scatter_n(exact) == pytest.approx(0.0, abs=1e-9)
    assert unloaded_scatter_n(twice) == pytest.approx(2.0 * unloaded_scatter_n(ARM), rel=0.05)


def test_arms_scatter_as_those_of_the_independent_plant():
    of_file = read_nominal(find_arm("cdsm_lab"))
    exact = Workmanship().scaled(0.0)
    squares_n2 = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        command_rad = np.deg2rad(rng.uniform(-10.0, 10.0, 8))
        built = BuiltArm(of_file, Workmanship(), rng)
        built_n = built.gains * built.tensions_n(command_rad) + built.zeros_n
        off_n = built_n - BuiltArm(of_file, exact, rng).tensions_n(command_rad)
        squares_n2.append(np.mean(off_n**2))
    assert unloaded_scatter_n(ARM) == pytest.approx(np.sqrt(np.mean(squares_n2)), rel=0.2)
