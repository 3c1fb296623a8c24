"""Machines that feel forces in one plane alone: which plane, and hung weights by one tendon."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cablesense_base import Array
from cablesense_contact.calibration import Calibrator, Unloaded
from cablesense_contact.judgement import ContactState, Judge
from cablesense_contact.machine.felt_directions import felt_across, is_planar
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_contact.machine.law import MachineLaw
from cablesense_contact.machine.observation import Observer
from cablesense_ros.cli.machine_info import machine_observability, notes_on_links
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce
from tests.helpers.example_machines import (
    ROD_FILE,
    ROD_LENGTH_M,
    ROD_LINKS,
    ROD_SERVO_N_M,
    example_machine,
    rod_model,
    written_machine,
)
from tests.helpers.torch_stater import TorchStater

PRETENSION_N = 3.0
WEIGHTS_N = (0.1, 0.3, 0.6)


def hung_tension_n(model: mujoco.MjModel, command_m: float, weight_n: float) -> float:
    """The wire's tension once MuJoCo's integrator has brought the rod with a weight to rest."""
    data = mujoco.MjData(model)
    data.ctrl[0] = command_m
    body = model.body(f"link_{ROD_LINKS}").id
    tip_m = np.array([ROD_LENGTH_M, 0.0, 0.0])
    hung_n = np.array([0.0, 0.0, -weight_n])
    for _ in range(6000):
        mujoco.mj_kinematics(model, data)
        point_m = data.xpos[body] + data.xmat[body].reshape(3, 3) @ tip_m
        data.qfrc_applied[:] = 0.0
        mujoco.mj_applyFT(model, data, hung_n, np.zeros(3), point_m, body, data.qfrc_applied)
        mujoco.mj_step(model, data)
    return float(-data.actuator_force[0])


@pytest.mark.slow
def test_one_tendon_tells_the_weights_that_are_hung_on_the_tip(tmp_path: Path) -> None:
    """The truth is MuJoCo's integrator; the machine touches at one place, so no rival remains."""
    machine = written_machine(tmp_path, rod_model(), ROD_FILE)
    model = mujoco.MjModel.from_xml_string(rod_model())
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    command_m = float(data.ten_length[0]) - PRETENSION_N / ROD_SERVO_N_M
    felt = FeltModel(machine)
    law = MachineLaw(machine, TorchStater(machine))
    calibrator = Calibrator(felt, law)
    command = np.array([command_m])
    untouched = np.array([hung_tension_n(model, command_m, 0.0)])
    tare = Unloaded(untouched, command, count=50)
    known = calibrator.updated(calibrator.by_tolerances(), tare)
    readings = np.array([[hung_tension_n(model, command_m, weight)] for weight in WEIGHTS_N])
    count = len(machine.coordinates)
    commands = np.tile(command, (len(readings), 1))
    still = np.zeros((count, count))
    seen = law(readings, commands, known.mean, known.covariance, still)
    judgements = Judge(felt).batch(seen, readings)
    assert set(judgements.state) == {ContactState.CONTACT}
    np.testing.assert_allclose(-seen.force_n[:, 2], WEIGHTS_N, rtol=0.05)
    low_n, high_n = seen.magnitude_ci95_n.T
    assert (low_n < WEIGHTS_N).all()
    assert (high_n > WEIGHTS_N).all()


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 2.0])
def test_parallel_hinges_feel_forces_across_them(tmp_path: Path, angle: float) -> None:
    hinge = np.array([np.cos(angle), np.sin(angle)])
    axis = f"0 {hinge[0]:.12g} {hinge[1]:.12g}"
    machine = written_machine(tmp_path, rod_model(axis), ROD_FILE)
    across: Array = np.array([-hinge[1], hinge[0]])
    in_frame = machine.links.axes[0, 1:, 1:].T @ across
    np.testing.assert_allclose(
        felt_across(Observer(machine))[0], np.outer(in_frame, in_frame), atol=1e-9
    )


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 2.0])
def test_info_says_along_which_direction_a_link_is_felt(tmp_path: Path, angle: float) -> None:
    """In the axes of its body, across the hinges and the link."""
    axis = f"0 {np.cos(angle):.12g} {np.sin(angle):.12g}"
    written_machine(tmp_path, rod_model(axis), ROD_FILE)
    seen = machine_observability(str(tmp_path / "machine.yaml"))
    (link,) = seen["links"]
    along = np.array(link["felt_along"])
    expected = np.array([0.0, -np.sin(angle), np.cos(angle)])
    np.testing.assert_allclose(np.abs(along @ expected), 1.0, atol=2e-3)
    assert "link_5 (0" in notes_on_links(seen)


def test_only_the_first_link_of_crossed_hinges_is_felt_in_a_plane() -> None:
    machine = example_machine("seven_hinges")
    planar = is_planar(felt_across(Observer(machine)))
    assert planar.tolist() == [True] + [False] * 6


def test_a_wire_feels_forces_in_its_plane_though_the_rod_bends_in_all_directions(
    tmp_path: Path,
) -> None:
    machine = written_machine(tmp_path, rod_model(across="0 0 1"), ROD_FILE)
    upwards = machine.links.axes[0, 2, 1:]
    projection = felt_across(Observer(machine))[0]
    np.testing.assert_allclose(projection, np.outer(upwards, upwards), atol=0.01)


BELT_MODEL = """
<mujoco>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" stiffness="2"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.01" mass="0.2"/>
      <body name="lower" pos="0.2 0 0">
        <joint name="elbow" axis="0 1 0" stiffness="2"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.01" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="belt">
      <joint joint="shoulder" coef="0.02"/>
      <joint joint="elbow" coef="0.01"/>
    </fixed>
  </tendon>
  <actuator><position name="motor" tendon="belt" kp="5000"/></actuator>
</mujoco>
"""

BELT_FILE = """
joints: actuators
sensors:
  tension: {of: [belt], noise_std: 0.05}
cables: {pretension_n: 200}
touch:
  largest_n: 5
  links:
    - {link: lower, start_m: [0.199, 0, 0], end_m: [0.2, 0, 0]}
"""


def test_joints_alone_may_define_a_tendon(tmp_path: Path) -> None:
    """Two joints that one motor turns by belts: there is no site in the whole model."""
    machine = written_machine(tmp_path, BELT_MODEL, BELT_FILE)
    felt = FeltModel(machine)
    law = MachineLaw(machine, TorchStater(machine))
    exact = np.zeros(len(law.observer.parameters))
    nominal = SimulatedMachine(machine, law.observer.parameters, exact)
    command = law.observer.command_of(machine.reference)
    untouched = nominal.untouched(command)
    push = LinkForce(0, np.array([0.1995, 0.0, 0.0]), np.array([0.0, 0.0, -0.5]))
    reading = nominal.touched(command, (push,), untouched).values
    known = np.outer(exact, exact)
    seen = law(reading[None], command[None], exact, known, np.zeros((2, 2)))
    assert Judge(felt)(seen, reading).state is ContactState.CONTACT
    assert seen.force_n[0, 2] == pytest.approx(-0.5, rel=0.05)


@pytest.mark.parametrize("lifting_n", [0.35, 0.8, 2.0])
def test_what_takes_the_only_tendon_slack_may_be_any_larger_force(
    tmp_path: Path, lifting_n: float
) -> None:
    machine = written_machine(tmp_path, rod_model(), ROD_FILE)
    law = MachineLaw(machine, TorchStater(machine))
    exact = np.zeros(len(law.observer.parameters))
    nominal = SimulatedMachine(machine, law.observer.parameters, exact)
    command = law.observer.command_of(machine.reference)
    untouched = nominal.untouched(command)
    tip_m = machine.links.touched_m[0].mean()
    lifted = LinkForce(0, np.array([tip_m, 0.0, 0.0]), np.array([0.0, 0.0, lifting_n]))
    reading = nominal.touched(command, (lifted,), untouched).values
    assert reading[0] == pytest.approx(0.0, abs=1e-6)
    count = len(machine.coordinates)
    seen = law(
        reading[None], command[None], exact, np.outer(exact, exact), np.zeros((count, count))
    )
    low_n, high_n = seen.magnitude_ci95_n[0]
    assert low_n <= lifting_n <= high_n
    assert high_n == machine.source.file.touch.largest_n
