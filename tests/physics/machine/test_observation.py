"""Observations of machines: derivatives against differences of rests, and closed forms."""

from pathlib import Path

import numpy as np
import pytest

from cablesense_base import Array
from cablesense_contact.machine.observation import Observation, Observer, OperatingPoint
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce
from tests.helpers.example_machines import (
    ROD_FILE,
    bent_command,
    example_machine,
    rod_model,
    written_machine,
)

PLACES_A_KIND = 4
STEP = 0.1
"""Of a deviation of a parameter, by which rests are compared."""


def observed(
    machine: Machine, values: Array, command: Array, near: Array | None
) -> tuple[Observer, Observation]:
    """What exact values say of a machine as described."""
    observer = Observer(machine)
    parameters = observer.parameters
    exact = np.zeros(len(parameters))
    covariance = np.diag(parameters.prior_std**2)
    count = len(machine.coordinates)
    still = np.zeros((count, count))
    operating_point = None if near is None else OperatingPoint(near)
    return observer, observer.observe(values, command, exact, covariance, still, operating_point)


def push(machine: Machine, share: float) -> LinkForce:
    """A share of the largest force in the middle of the last link."""
    link = len(machine.links.names) - 1
    point_m = np.array([float(machine.links.touched_m[link].mean()), 0.0, 0.0])
    largest_n = machine.source.file.touch.largest_n
    return LinkForce(link, point_m, share * largest_n * np.array([0.2, 0.6, -0.7]))


@pytest.mark.parametrize("name", ["finger", "seven_hinges", "hand", "continuum", "six_axis"])
@pytest.mark.parametrize("share", [0.0, 0.05])
def test_readings_follow_every_kind_of_parameter(name: str, share: float) -> None:
    machine = example_machine(name)
    observer = Observer(machine)
    parameters = observer.parameters
    command = bent_command(machine, seed=6)
    exact = np.zeros(len(parameters))
    contacts = (push(machine, share),) if share else ()
    described = SimulatedMachine(machine, parameters, exact)
    rest = described.touched(command, contacts, described.untouched(command))
    _, seen = observed(machine, rest.values, command, None if machine.is_measured else rest.pose)
    # torques of drives are what they hold the machine with: an observation is of what is missing
    sign = -1.0 if machine.is_measured else 1.0
    largest = np.abs(seen.by_parameter * parameters.prior_std).max()
    for kind, own in parameters.slices.items():
        numbers = np.arange(len(parameters))[own]
        for number in numbers[:: max(1, len(numbers) // PLACES_A_KIND)]:
            std = parameters.prior_std[number]
            if std == 0.0:
                continue
            readings = []
            for side in (1.0, -1.0):
                theta = exact.copy()
                theta[number] = side * STEP * std
                built = SimulatedMachine(machine, parameters, theta)
                # what acts keeps its direction in base axes
                axes = described.frames(command, rest).axes
                forces = [
                    LinkForce(one.link, one.point_m, axes[one.link] @ one.force_n)
                    for one in contacts
                ]
                readings.append(built.under(command, forces, None).values)
            difference = sign * (readings[0] - readings[1]) / (2.0 * STEP)
            # how sites and weights enter is taken at the untouched machine: exact there
            allowed = 0.02 * largest if share else 1e-4 * largest
            np.testing.assert_allclose(
                seen.by_parameter[:, number] * std, difference, atol=allowed, err_msg=kind
            )


def test_one_error_of_all_springs_changes_readings_as_if_each_had_it(tmp_path: Path) -> None:
    """A rod of hinges whose material is softer throughout, as the rest of such a rod has it."""
    file = ROD_FILE + "tolerances: {common_joint_stiffness_share: 0.2}"
    machine = written_machine(tmp_path, rod_model(), file)
    parameters = Observer(machine).parameters
    exact = np.zeros(len(parameters))
    described = SimulatedMachine(machine, parameters, exact)
    command = Observer(machine).command_of(machine.reference)
    rest = described.untouched(command)
    _, seen = observed(machine, rest.values, command, rest.pose)
    common = parameters.slices["common_joint_stiffness"]
    of_springs = parameters.slices["joint_stiffness"]
    assert parameters.prior_std[common].tolist() == [0.2]
    share = 1e-3
    softer = exact.copy()
    softer[common] = -share
    stiffer = -softer
    readings = [
        SimulatedMachine(machine, parameters, theta).untouched(command).values
        for theta in (stiffer, softer)
    ]
    difference = (readings[0] - readings[1]) / (2.0 * share)
    by_common = seen.by_parameter[:, common]
    np.testing.assert_allclose(by_common[:, 0], difference, rtol=1e-3)
    np.testing.assert_allclose(by_common[:, 0], seen.by_parameter[:, of_springs].sum(axis=1))


@pytest.mark.parametrize("name", ["finger", "seven_hinges", "hand", "continuum"])
def test_readings_follow_contact_forces(name: str) -> None:
    machine = example_machine(name)
    parameters = Observer(machine).parameters
    command = bent_command(machine, seed=7)
    described = SimulatedMachine(machine, parameters, np.zeros(len(parameters)))
    untouched = described.untouched(command)
    rest = described.touched(command, (push(machine, 0.05),), untouched)
    _, seen = observed(machine, rest.values, command, rest.pose)
    more = 1e-4
    grown = described.touched(command, (push(machine, 0.05 * (1.0 + more)),), untouched)
    contact = push(machine, 0.05)
    place_m = contact.point_m[0]
    levers = seen.levers[contact.link]
    torque = contact.force_n @ (levers[:3] + place_m * levers[3:])
    # levers, too, turn with the machine: under a force of this size by less than this
    change = (grown.values - rest.values) / more
    expected = seen.by_torque @ torque
    np.testing.assert_allclose(change, expected, atol=0.03 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["finger", "seven_hinges", "hand"])
def test_the_pose_behind_a_reading_is_where_the_machine_is(name: str) -> None:
    """Where there are more tendons than hinges, whatever touches the machine."""
    machine = example_machine(name)
    parameters = Observer(machine).parameters
    command = bent_command(machine, seed=8)
    described = SimulatedMachine(machine, parameters, np.zeros(len(parameters)))
    untouched = described.untouched(command)
    rest = described.touched(command, (push(machine, 0.3),), untouched)
    _, seen = observed(machine, rest.values, command, None)
    moved = np.abs(rest.pose - untouched.pose).max()
    assert np.abs(seen.pose - rest.pose).max() < 0.02 * moved
    # the torque that explains the innovation is that of the contact
    contact = push(machine, 0.3)
    levers = seen.levers[contact.link]
    torque = contact.force_n @ (levers[:3] + contact.point_m[0] * levers[3:])
    found, *_ = np.linalg.lstsq(seen.by_torque, seen.innovation, rcond=None)
    np.testing.assert_allclose(found, torque, atol=0.01 * np.abs(torque).max())


PULLEY_M = 0.02
LEVER_MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 {gravity}"/>
  <worldbody>
    <site name="above" pos="-0.1 0 {inside}"/>
    <site name="below" pos="-0.1 0 -{inside}"/>
    <body name="lever">
      <joint name="hinge" axis="0 1 0"/>
      <geom name="pulley" type="cylinder" size="{radius} 0.01" zaxis="0 1 0" mass="0.0"
            contype="0" conaffinity="0"/>
      <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.01" mass="1.0"
            contype="0" conaffinity="0"/>
      <site name="over" pos="0 0 0.1"/>
      <site name="under" pos="0 0 -0.1"/>
      <site name="end_above" pos="0.1 0 {inside}"/>
      <site name="end_below" pos="0.1 0 -{inside}"/>
    </body>
  </worldbody>
  <tendon>
    <spatial name="upper">
      <site site="above"/><geom geom="pulley" sidesite="over"/><site site="end_above"/>
    </spatial>
    {lower}
  </tendon>
  <actuator>
    <position name="upper_drive" tendon="upper" kp="1e5" forcerange="-1e4 0"/>
    {lower_drive}
  </actuator>
</mujoco>
"""
LOWER = """<spatial name="lower">
      <site site="below"/><geom geom="pulley" sidesite="under"/><site site="end_below"/>
    </spatial>"""
LOWER_DRIVE = '<position name="lower_drive" tendon="lower" kp="1e5" forcerange="-1e4 0"/>'
LEVER_FILE = """
joints: commanded
sensors:
  tension: {{of: [{tendons}], noise_std: 0.01}}
cables: {{pretension_n: {pretension}}}
touch:
  largest_n: 20
  links:
    - {{link: lever, start_m: [0, 0, 0], end_m: [0.4, 0, 0]}}
"""


def lever(folder: Path, *, antagonist: bool) -> Machine:
    """A lever on a pulley, whose weight one tendon bears, or that two pull against each other."""
    model = LEVER_MODEL.format(
        gravity=0.0 if antagonist else -9.81,
        radius=PULLEY_M,
        inside=0.5 * PULLEY_M,
        lower=LOWER if antagonist else "",
        lower_drive=LOWER_DRIVE if antagonist else "",
    )
    tendons = "upper, lower" if antagonist else "upper"
    pretension_n = 100.0 if antagonist else 1.0 * 9.81 * 0.2 / PULLEY_M
    file = LEVER_FILE.format(tendons=tendons, pretension=pretension_n)
    return written_machine(folder, model, file)


def touched_lever(machine: Machine, force_n: float, place_m: float) -> tuple[Array, Array, float]:
    """Tensions without and with a force downward, and the angle with it."""
    parameters = Observer(machine).parameters
    described = SimulatedMachine(machine, parameters, np.zeros(len(parameters)))
    untouched = described.untouched(np.zeros(1))
    force = LinkForce(0, np.array([place_m, 0.0, 0.0]), np.array([0.0, 0.0, -force_n]))
    touched = described.under(np.zeros(1), (force,), untouched.pose)
    return untouched.values, touched.values, float(touched.pose[0])


def test_a_tendon_on_a_pulley_bears_torque_over_radius(tmp_path: Path) -> None:
    machine = lever(tmp_path, antagonist=False)
    before, after, angle = touched_lever(machine, force_n=10.0, place_m=0.3)
    assert before[0] == pytest.approx(9.81 * 0.2 / PULLEY_M, rel=1e-9)
    torque = (9.81 * 0.2 + 10.0 * 0.3) * np.cos(angle)
    assert after[0] == pytest.approx(torque / PULLEY_M, rel=1e-7)


def test_two_equal_tendons_share_a_torque_in_opposite_directions(tmp_path: Path) -> None:
    machine = lever(tmp_path, antagonist=True)
    before, after, angle = touched_lever(machine, force_n=5.0, place_m=0.4)
    half_n = 5.0 * 0.4 * np.cos(angle) / (2.0 * PULLEY_M)
    np.testing.assert_allclose(after - before, [half_n, -half_n], rtol=1e-6)


def test_a_slack_tendon_leaves_the_torque_to_the_other(tmp_path: Path) -> None:
    machine = lever(tmp_path, antagonist=True)
    _, after, angle = touched_lever(machine, force_n=20.0, place_m=0.4)
    torque = 20.0 * 0.4 * np.cos(angle)
    np.testing.assert_allclose(after, [torque / PULLEY_M, 0.0], rtol=1e-6)


@pytest.mark.parametrize("deviations", [-2.0, 2.0])
@pytest.mark.parametrize("curl_rad", [0.165, 0.17, 0.175])
def test_the_other_side_of_a_kink_is_allowed_for(curl_rad: float, deviations: float) -> None:
    """At 0.167 rad the flexor of the hand's thumb leaves its pulley, and forces have a kink."""
    machine = example_machine("hand")
    observer = Observer(machine)
    parameters = observer.parameters
    command = np.zeros(len(machine.coordinates))
    command[machine.coordinates.names.index("thumb_curl")] = curl_rad
    zero = parameters.names.index("joint_zero of thumb_curl")
    off = np.zeros(len(parameters))
    off[zero] = deviations * parameters.prior_std[zero]
    reading = SimulatedMachine(machine, parameters, off).untouched(command).values
    covariance = np.diag(parameters.prior_std**2)
    still = np.zeros((len(command), len(command)))
    seen = observer.observe(reading, command, np.zeros(len(parameters)), covariance, still)
    chi2 = float(seen.innovation @ seen.information @ seen.innovation)
    assert chi2 < 5.0
