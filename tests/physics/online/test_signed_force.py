"""The table of estimates says to which side a force acts, along the axes of the touched body."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cablesense_contact.machine.law import MachineLaw
from cablesense_msgs_py.messages import ForceState
from cablesense_online.answer import Answer
from cablesense_online.answer_table import ANSWER_COLUMNS, NO_CELL, answer_cells
from cablesense_online.machine_models import LoadedMachine
from cablesense_online.placed_links import PlacedLinks
from cablesense_online.recorded_estimates import recorded_answers
from cablesense_recording.recording import Recording
from cablesense_ros.default_settings import node_settings
from cablesense_sim.machine.simulated import SimulatedMachine
from tests.helpers.example_machines import written_machine
from tests.helpers.torch_stater import TorchStater

SPRING_N_M_RAD = 2.0
ARM_M = 0.02
SERVO_N_M = 5000.0
REACH_M = 0.2
PUSH_N = 0.4
UNTOUCHED = 30
PUSHED = 10

WIRE = '<spatial name="wire"><site site="guide"/><site site="anchor"/></spatial>'
DRUM = f'<fixed name="wire"><joint joint="bend" coef="{ARM_M}"/></fixed>'
"""A wire on a drum about the hinge, which the model does not draw."""

UPRIGHT_MODEL = f"""
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <site name="guide" pos="{-ARM_M} 0 0"/>
    <body name="finger">
      <joint name="bend" axis="0 1 0" stiffness="{SPRING_N_M_RAD}"/>
      <site name="anchor" pos="{-ARM_M} 0 0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 {REACH_M}" size="0.01" mass="0.2"/>
    </body>
  </worldbody>
  <tendon>{WIRE}</tendon>
  <actuator><position name="motor" tendon="wire" kp="{SERVO_N_M}"/></actuator>
</mujoco>
"""
UPRIGHT_FILE = f"""
joints: actuators
sensors:
  tension: {{of: [wire], noise_std: 0.005}}
cables: {{pretension_n: 10}}
touch:
  largest_n: 2
  links:
    - {{link: finger, start_m: [0, 0, {REACH_M - 0.0005}], end_m: [0, 0, {REACH_M + 0.0005}]}}
"""


def tension_change_n(force_n: float) -> float:
    """Of the wire, by a force at the tip along the body's x axis: the hinge's balance of torques.

    F L = k q + r ΔT about y, with ΔT = K r q.
    """
    turned_rad = force_n * REACH_M / (SPRING_N_M_RAD + SERVO_N_M * ARM_M**2)
    return SERVO_N_M * ARM_M * turned_rad


def table_row(answer: Answer, links: PlacedLinks) -> dict[str, Any]:
    return dict(zip(ANSWER_COLUMNS, answer_cells(answer, links), strict=True))


@pytest.fixture(params=[WIRE, DRUM], ids=["through sites", "by its joint"])
def finger(tmp_path: Path, request: pytest.FixtureRequest) -> LoadedMachine:
    """Its axis is z of its body, so that contact angles count in another frame."""
    model = UPRIGHT_MODEL.replace(WIRE, request.param)
    machine = written_machine(tmp_path, model, UPRIGHT_FILE)
    return LoadedMachine(machine, MachineLaw(machine, TorchStater(machine)), "")


@pytest.fixture
def answers(finger: LoadedMachine) -> list[Answer]:
    """Untouched, pushed towards +x, then towards -x."""
    return answers_of(finger)


def answers_of(finger: LoadedMachine) -> list[Answer]:
    """Untouched, pushed towards +x, then towards -x, each long enough to be at rest."""
    exact = np.zeros(len(finger.machine.parameters))
    observer = finger.law.observer
    nominal = SimulatedMachine(observer.machine, observer.parameters, exact)
    command = finger.machine.first_command
    pushes_n = np.repeat([0.0, PUSH_N, -PUSH_N], [UNTOUCHED, PUSHED, PUSHED])
    changes_n = np.array([[tension_change_n(push_n)] for push_n in pushes_n])
    rows = len(pushes_n)
    recording = Recording(
        name="pushes",
        time_s=0.2 * np.arange(rows, dtype=float),
        trial=np.zeros(rows, dtype=np.int64),
        command_rad=np.tile(command, (rows, 1)),
        load_segment=np.zeros(rows, dtype=np.int64),
        load_n=np.zeros((rows, 3)),
        tensions_n=nominal.untouched(command).values + changes_n,
    )
    settings = node_settings(tare_samples=20)
    by_row = [recorded.answer for recorded in recorded_answers(recording, finger, settings)]
    return [by_row[UNTOUCHED - 1], by_row[UNTOUCHED + PUSHED - 1], by_row[-1]]


def test_pushes_to_both_sides_have_opposite_signs(
    finger: LoadedMachine, answers: list[Answer]
) -> None:
    links = PlacedLinks(finger.machine.link_frames)
    untouched, towards, back = (table_row(answer, links) for answer in answers)
    assert untouched["force_x_n"] == NO_CELL
    for row, push_n in ((towards, PUSH_N), (back, -PUSH_N)):
        assert row["state"] == "contact"
        assert row["force_x_n"] == pytest.approx(push_n, rel=0.05)
        assert row["force_y_n"] == pytest.approx(0.0, abs=1e-9)  # along the hinge: not felt
        assert row["magnitude_low_n"] < PUSH_N < row["magnitude_high_n"]


def test_where_no_force_or_no_direction_is_known_none_is_stated(
    finger: LoadedMachine, answers: list[Answer]
) -> None:
    links = PlacedLinks(finger.machine.link_frames)
    pushed = answers[1]
    by_moment = pushed.contact._replace(magnitude_n=0.0, moment_n_m=PUSH_N * REACH_M)
    moment = replace(pushed, force=ForceState.MOMENT, contacts=(by_moment,))
    of_several = replace(pushed, estimate=None)
    for answer in (moment, of_several):
        row = table_row(answer, links)
        assert row["segment"] == 1
        assert [row[f"force_{axis}_n"] for axis in "xyz"] == [NO_CELL] * 3
    by_its_moment = table_row(moment, links)
    assert by_its_moment["magnitude_n"] == NO_CELL
    assert by_its_moment["magnitude_low_n"] > 0.0
    assert by_its_moment["angle_deg"] == pytest.approx(180.0)  # it counts from the body's -x
    of_network = table_row(of_several, links)
    assert of_network["magnitude_n"] == pytest.approx(PUSH_N, rel=0.05)
    assert of_network["angle_deg"] == NO_CELL


def test_an_axial_force_that_is_not_known_is_not_stated(tmp_path: Path) -> None:
    """On a surface it turns the hinge a little, so it is estimated, to a tenth of a newton."""
    on_surface = UPRIGHT_FILE.replace("]}\n", "], radius_m: 0.02}\n")
    machine = written_machine(tmp_path, UPRIGHT_MODEL, on_surface)
    finger = LoadedMachine(machine, MachineLaw(machine, TorchStater(machine)), "")
    _, pushed, _ = answers_of(finger)
    assert pushed.estimate is not None
    assert pushed.estimate.place is not None
    axial_std_n = float(pushed.estimate.place.covariance[1, 1]) ** 0.5
    assert axial_std_n > finger.machine.known_n
    assert pushed.estimate.place.along_n != 0.0
    assert pushed.contact.along_n == 0.0
