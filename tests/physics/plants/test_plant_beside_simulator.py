"""The plant beside the simulator: no code is shared, and friction does the same to both arms."""

from dataclasses import replace

import numpy as np
import pytest

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.simulator import Term
from cablesense_plants.arm.arm import draw_schedule, ideal_arm
from cablesense_plants.arm.friction import PlantFriction
from cablesense_recording.recording import Recording
from cablesense_sim.arm import open_arm
from tests.helpers.plant_arm import ARM_FILE, NOMINAL

pytestmark = pytest.mark.slow

WHOLE = draw_schedule(NOMINAL, np.random.default_rng(3))
ROWS = np.append(np.arange(53), np.arange(820, 890))
SCHEDULE = type(WHOLE)._make(column[ROWS] for column in WHOLE)


def plant_n(friction: PlantFriction) -> np.ndarray:
    arm = replace(ideal_arm(NOMINAL), friction=friction)
    loads = arm.point_loads_n(SCHEDULE)
    held = arm.held_m(SCHEDULE.command_rad)
    path = arm.path()
    sensed = []
    state = path.start(SCHEDULE.command_rad[0], held[0], loads[0])
    for i in range(1, len(held)):
        state = path.advance(state, held[i], loads[i], 1.0)
        sensed.append(state.sensed_n)
    return np.array(sensed)


def simulated_n(**parameters: float) -> np.ndarray:
    columns = SCHEDULE._asdict()
    recording = Recording(name="", **columns, tensions_n=np.full((len(ROWS), 12), 50.0))
    arm = ArmSimulator(open_arm(ARM_FILE), recording)
    terms = {Term("capstan_friction", "arm", name): x for name, x in parameters.items()}
    return arm.predict([terms])[0][1:]


@pytest.mark.parametrize(
    ("plant", "simulator"),
    [
        ({}, {}),
        ({"presliding_m": 4e-5}, {"give_m": 4e-5}),
        ({"pulley_rad": 1.0}, {"pulley_wrap_rad": 1.0}),
        ({"pulley_rad": 1.0, "weightless": True}, {"pulley_wrap_rad": 1.0, "weight_borne": 0.0}),
    ],
)
def test_friction_changes_both_alike(plant: dict[str, float], simulator: dict[str, float]) -> None:
    """Both have the same nodes and pieces; they share no code and no method of solution."""
    rough = plant_n(PlantFriction(np.full(12, 0.2), actuator_share=0.3, **plant))
    same = {"coefficient": 0.2, "pulley_wrap_rad": 0.0, "guide_wrap_rad": 0.0, "give_m": 0.0}
    simulated = simulated_n(**same | {"run_compliance": 0.3 / 0.7} | simulator)
    np.testing.assert_allclose(simulated, rough, atol=1e-4)
    assert np.abs(rough - plant_n(PlantFriction())).max() > 1.0
