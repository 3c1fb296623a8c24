"""Friction of tendons: their pieces, what rubbing machines read, and what readings say of it."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablesense_base import Array
from cablesense_contact.calibration import Calibrator, Unloaded
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_contact.machine.law import MachineLaw
from cablesense_contact.machine.observation import Observer, OperatingPoint
from cablesense_contact.machine.tendon_friction import CarriedTendonFriction
from cablesense_contact.slides import Belief
from cablesense_online.machine_simulation import MachineSimulation
from cablesense_online.simulation import SimulationSettings
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.quasi_static import QuasiStaticMachine
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce, MachineStatics
from cablesense_sim.machine.tendon_guides import RUN_COMPLIANCE, TendonGuides
from cablesense_sim.machine.tendon_paths import TendonPaths
from tests.helpers.example_machines import (
    bent_command,
    example_machine,
    machine_with_friction,
    written_machine,
)
from tests.helpers.torch_stater import TorchStater

EXAMPLES = ("finger", "hand", "seven_hinges", "continuum")
COEFFICIENT = 0.2
SPRING_N_M = 1000.0

HOIST = f"""
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <site name="drum" pos="-0.1 0 0.01"/>
    <geom name="pulley" type="cylinder" zaxis="0 1 0" size="0.01 0.01" contype="0"/>
    <site name="beside" pos="0.02 0 0.02"/>
    <body name="block" pos="0.01 0 -0.1">
      <joint name="lift" type="slide" axis="0 0 1" stiffness="{SPRING_N_M}"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.05" size="0.005" mass="1" contype="0"/>
      <site name="hook"/>
    </body>
  </worldbody>
  <tendon>
    <spatial name="rope">
      <site site="drum"/><geom geom="pulley" sidesite="beside"/><site site="hook"/>
    </spatial>
  </tendon>
  <actuator><position name="winch" tendon="rope" kp="1e5"/></actuator>
</mujoco>
"""
"""A rope over a fixed pulley, a quarter turn, lifts a block against a spring."""

HOIST_FILE = """
sensors: {tension: {of: [rope], noise_std: 0.01}}
cables: {pretension_n: 0, stiffness_n_m: 1.0e+5, friction_coefficient: 0.2}
touch:
  largest_n: 100
  links: [{link: block, start_m: [0, 0, 0], end_m: [0, 0, -0.05], radius_m: 0.005}]
"""


KINDS = """
<mujoco>
  <worldbody>
    <site name="start" pos="-0.1 0 0.02"/>
    <site name="beside" pos="0 0 0.05"/>
    <geom name="ball" type="sphere" size="0.02" contype="0"/>
    <site name="return" pos="-0.1 0.02 0.03"/>
    <body name="upper" pos="0.04 0 0">
      <joint name="bend" axis="0 1 0"/>
      <joint name="spread" axis="0 0 1"/>
      <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.005" mass="0.1" contype="0"/>
      <geom name="eye" type="cylinder" pos="0.05 0 0.02" zaxis="0 1 0" size="0.02 0.02"/>
      <site name="in_eye" pos="0.05 0 0.012"/>
      <site name="middle" pos="0.02 0.001 0.015"/>
      <site name="end" pos="0.09 0.002 0.01"/>
    </body>
  </worldbody>
  <tendon>
    <spatial name="divided">
      <site site="start"/><geom geom="ball" sidesite="beside"/><site site="middle"/>
      <geom geom="eye" sidesite="in_eye"/><site site="end"/>
      <pulley divisor="2"/>
      <site site="return"/><site site="middle"/>
    </spatial>
    <fixed name="coupled"><joint joint="bend" coef="0.01"/></fixed>
  </tendon>
  <actuator>
    <position name="first" tendon="divided" kp="1e5"/>
    <position name="second" tendon="coupled" kp="1e5"/>
  </actuator>
</mujoco>
"""
"""A tendon around a ball, through an eye and over a block, and one that joints are coupled by."""

KINDS_FILE = """
sensors: {tension: {of: [divided, coupled], noise_std: 0.01}}
cables: {pretension_n: 10, stiffness_n_m: 1.0e+5}
touch: {links: [{link: upper, start_m: [0, 0, 0], end_m: [0.1, 0, 0], radius_m: 0.005}]}
"""


@pytest.fixture
def hoist(tmp_path: Path) -> Machine:
    return written_machine(tmp_path, HOIST, HOIST_FILE)


def as_described(machine: Machine) -> SimulatedMachine:
    parameters = MachineParameters(machine)
    return SimulatedMachine(machine, parameters, np.zeros(len(parameters)))


@pytest.mark.parametrize("name", EXAMPLES)
def test_pieces_add_up_to_what_mujoco_has_of_the_tendon(name: str) -> None:
    machine = example_machine(name)
    paths = TendonPaths(machine)
    guides = TendonGuides(machine)
    away_rad = np.random.default_rng(5).uniform(-0.3, 0.3, len(machine.coordinates))
    pose = machine.reference + away_rad
    balance = MachineStatics(machine).at(pose)
    there = paths.at(pose)
    merged = guides.at(pose)
    assert_allclose(there.length_m.sum(axis=1), balance.length_m, rtol=1e-9)
    assert_allclose(there.slope_m.sum(axis=1), balance.moment, atol=1e-12)
    assert_allclose(merged.length_m.sum(axis=1), balance.length_m, rtol=1e-9)
    assert_allclose(merged.slope_m.sum(axis=1), balance.moment, atol=1e-12)


def test_pieces_add_up_on_tendons_of_every_kind(tmp_path: Path) -> None:
    machine = written_machine(tmp_path, KINDS, KINDS_FILE)
    paths = TendonPaths(machine)
    statics = MachineStatics(machine)
    for bend_rad in np.linspace(-0.6, 0.6, 13):
        pose = np.array([bend_rad, 0.3 * bend_rad])
        balance = statics.at(pose)
        there = paths.at(pose)
        assert_allclose(there.length_m.sum(axis=1), balance.length_m, rtol=1e-6, atol=1e-9)
        assert_allclose(there.slope_m.sum(axis=1), balance.moment, atol=1e-9)
        assert (there.bend_rad >= 0.0).all()


@pytest.mark.parametrize("name", ["finger", "seven_hinges"])
def test_the_slope_of_a_piece_is_its_derivative(name: str) -> None:
    machine = example_machine(name)
    paths = TendonPaths(machine)
    pose = bent_command(machine, seed=6)
    step = 1e-5
    moves = step * np.eye(len(pose))
    differences = [
        (paths.at(pose + move).length_m - paths.at(pose - move).length_m) / (2.0 * step)
        for move in moves
    ]
    # arcs of tendons that are askew to their pulleys are those of helices to second order
    assert_allclose(paths.at(pose).slope_m, np.stack(differences, axis=-1), atol=2e-5)


def test_a_quarter_turn_is_a_quarter_turn(hoist: Machine) -> None:
    bend_rad = TendonPaths(hoist).at(np.zeros(1)).bend_rad
    assert_allclose(bend_rad, [[0.5 * np.pi]], rtol=1e-9)


def test_without_friction_it_is_the_machine_without_friction() -> None:
    machine = example_machine("finger")
    simulated = as_described(machine)
    command = bent_command(machine, seed=7)
    contact = LinkForce(1, np.array([0.02, 0.0, 0.0]), np.array([0.0, 0.3, 0.8]))
    moving = QuasiStaticMachine(simulated, machine.reference, 0.0)
    untouched = simulated.untouched(command)
    assert_allclose(moving.go(command).values, untouched.values, atol=1e-3)
    touched = simulated.touched(command, [contact], untouched)
    assert_allclose(moving.go(command, [contact]).values, touched.values, atol=1e-3)


def test_a_rope_over_a_pulley_obeys_euler_and_eytelwein(hoist: Machine) -> None:
    """Lifting, the winch pulls exp(μ π/2) times as hard as the spring; lowering, exp(-μ π/2)."""
    moving = QuasiStaticMachine(as_described(hoist), np.zeros(1), COEFFICIENT)
    ratio = np.exp(0.5 * np.pi * COEFFICIENT)
    lifted = moving.go(np.array([0.02]))
    assert_allclose(lifted.values[0], ratio * SPRING_N_M * lifted.pose[0], rtol=1e-5)
    lowered = moving.go(np.array([0.01]))
    assert_allclose(lowered.values[0], SPRING_N_M * lowered.pose[0] / ratio, rtol=1e-5)


def test_while_the_rope_sticks_the_winch_reads_nothing(hoist: Machine) -> None:
    """A pull at the block that the band holds; one that exceeds it is read beyond that alone."""
    moving = QuasiStaticMachine(as_described(hoist), np.zeros(1), COEFFICIENT)
    command = np.array([0.02])
    lifted = moving.go(command)
    middle_m = np.array([0.025, 0.0, 0.0])
    along = np.array([1.0, 0.0, 0.0])  # from the hook down
    held = moving.go(command, [LinkForce(0, middle_m, 3.0 * along)])
    assert_allclose(held.values, lifted.values, atol=1e-6)
    assert held.pose[0] < lifted.pose[0] - 1e-6
    pulled = moving.go(command, [LinkForce(0, middle_m, 60.0 * along)])
    spanned_n = SPRING_N_M * pulled.pose[0] + 60.0
    ratio = np.exp(0.5 * np.pi * COEFFICIENT)
    assert_allclose(pulled.values[0], spanned_n / ratio, rtol=1e-5)


def test_what_was_slid_stays_until_it_slides_back() -> None:
    """A command reached from two sides is two readings, by as much as friction holds."""
    machine = example_machine("finger")
    simulated = as_described(machine)
    command = machine.reference.copy()
    readings = []
    for side in (-0.15, 0.15):
        moving = QuasiStaticMachine(simulated, command + side, 0.05)
        readings.append(moving.go(command).values)
    between = simulated.untouched(command).values
    apart = readings[1] - readings[0]
    assert np.abs(apart).max() > 3.0
    assert (np.sign(readings[0] - between) == -np.sign(readings[1] - between)).all()


def test_joints_that_are_measured_are_refused() -> None:
    machine = example_machine("six_axis")
    with pytest.raises(MachineError, match="joints: measured"):
        QuasiStaticMachine(as_described(machine), machine.reference, 0.05)


def carried_by(
    moving: QuasiStaticMachine, machine: Machine, friction: CarriedTendonFriction
) -> Array:
    """(G M,) what a machine that rubs carries at its guides, by the tensions on both sides."""
    paths = TendonPaths(machine)
    tension_n = moving._tensions_n  # of each piece, which no sensor reads
    wrap_rad = friction.guides.at(moving.pose).wrap_rad
    carried = np.zeros(wrap_rad.shape)
    for row in range(len(wrap_rad)):
        spans = np.flatnonzero(paths.crosses[row])
        first = np.concatenate([[0], spans])
        for guide, (before, behind) in enumerate(pairwise(first)):
            if wrap_rad[row, guide] > 1e-3:
                ratio = tension_n[row, behind] / tension_n[row, before]
                carried[row, guide] = np.log(ratio) / wrap_rad[row, guide]
    return carried.T.ravel()


@pytest.mark.parametrize("name", ["finger", "seven_hinges"])
def test_readings_follow_from_what_is_carried(tmp_path: Path, name: str) -> None:
    """What the law expects with the plant's own carried friction is what the plant reads."""
    machine = machine_with_friction(name, 0.05, tmp_path)
    observer = Observer(machine)
    parameters = observer.parameters
    friction = CarriedTendonFriction(machine)
    command = bent_command(machine, seed=8)
    moving = QuasiStaticMachine(
        as_described(machine), machine.reference, 0.05, run_compliance=RUN_COMPLIANCE
    )
    reading = moving.go(command).values
    covariance = np.diag(parameters.prior_std**2)
    unrest = np.zeros((len(command), len(command)))
    even = np.zeros(len(parameters))
    carried = even.copy()
    carried[parameters.carried_friction] = carried_by(moving, machine, friction)
    known = observer.observe(reading, command, carried, covariance, unrest)
    ignored = observer.observe(reading, command, even, covariance, unrest)
    assert np.abs(known.innovation).max() < 0.1 * np.abs(ignored.innovation).max()


def test_derivatives_by_what_is_carried(tmp_path: Path) -> None:
    machine = machine_with_friction("finger", 0.1, tmp_path)
    observer = Observer(machine)
    parameters = observer.parameters
    part = parameters.carried_friction
    rng = np.random.default_rng(9)
    exists = parameters.prior_std[part] > 0.0
    mean = np.zeros(len(parameters))
    mean[part] = 0.05 * rng.uniform(-1.0, 1.0, len(exists)) * exists
    covariance = np.diag(parameters.prior_std**2)
    command = bent_command(machine, seed=10)
    unrest = np.zeros((len(command), len(command)))
    reading = as_described(machine).untouched(command).values
    seen = observer.observe(reading, command, mean, covariance, unrest)
    there = OperatingPoint(seen.pose)
    step = 1e-4
    for number in np.arange(part.start, part.stop)[exists]:
        ends = []
        for way in (-step, step):
            moved = mean.copy()
            moved[number] += way
            observed = observer.observe(reading, command, moved, covariance, unrest, there)
            ends.append(observed.innovation)
        slope = (ends[0] - ends[1]) / (2.0 * step)
        assert_allclose(seen.by_parameter[:, number], slope, rtol=0.03, atol=0.5)


@pytest.mark.slow
def test_followed_slides_are_those_of_the_machine_that_rubs(tmp_path: Path) -> None:
    """After motions nearly always; under a contact as surely as is stated, from few readings."""
    coefficient = 0.05
    machine = machine_with_friction("finger", coefficient, tmp_path)
    felt = FeltModel(machine)
    friction = CarriedTendonFriction(machine)
    mean = felt.parameters.prior_mean.copy()
    mean[felt.parameters.slices["friction"]] = coefficient
    known = Belief(mean, np.zeros((len(mean), len(mean))))
    exists = friction.guides.exists.ravel()
    rng = np.random.default_rng(11)
    came_right = []
    surely_right = []
    off_by_std = []
    for _ in range(6):
        command = machine.reference
        moving = QuasiStaticMachine(as_described(machine), command, coefficient)
        for _ in range(3):
            before = command
            command = machine.reference + np.deg2rad(rng.uniform(-10.0, 10.0, len(before)))
            untouched = moving.go(command)
            came = felt.slides.after_motion(before, command)
            truth = np.sign(carried_by(moving, machine, friction))
            came_right += list((np.sign(came.mean.ravel()) == truth)[exists])
            under_load = felt.slides.under_load(command, untouched.values, known, came)
            angle = rng.uniform(0.0, 2.0 * np.pi)
            force_n = rng.uniform(1.0, 5.0) * np.array([0.0, np.sin(angle), np.cos(angle)])
            contact = LinkForce(1, np.array([0.02, 0.0, 0.0]), force_n)
            slides = under_load.after(moving.go(command, [contact]).values).slides
            mean = slides.mean.ravel()
            truth = carried_by(moving, machine, friction) / coefficient
            is_sure = exists & (np.abs(mean) > 0.5)
            surely_right += list((np.sign(mean) == np.sign(truth))[is_sure])
            off_by_std += list(((truth - mean) / slides.std.ravel())[exists])
    assert np.mean(came_right) > 0.95
    assert np.mean(surely_right) > 0.8
    assert np.sqrt(np.mean(np.square(off_by_std))) < 1.2


def test_the_machine_of_the_sim_rubs_if_its_file_says_so(tmp_path: Path) -> None:
    """It comes to the same command from two sides with two readings."""
    machine = machine_with_friction("finger", 0.1, tmp_path)
    settings = SimulationSettings(
        rate_hz=0.0, joint_speed_rad_s=10.0, load_timeout_s=0.0, built_seed=3
    )
    moving = MachineSimulation(machine, settings, now_s=0.0)
    now_s = 0.0
    bent = np.full(len(machine.reference), 0.1)
    readings = []
    for start in (-bent, bent):
        for command in (machine.reference + start, machine.reference):
            moving.go_to(command)
            for _ in range(12):
                now_s += 0.02
                moving.advance_to(now_s)
        readings.append(moving.reading(None))
    assert moving.refusals == 0
    assert np.abs(readings[1] - readings[0]).max() > 1.0


@pytest.mark.slow
def test_unloaded_poses_tell_the_coefficient(tmp_path: Path) -> None:
    """Of a machine that is built within tolerances, and whose way is known."""
    coefficient = 0.07
    machine = machine_with_friction("finger", 0.1, tmp_path)
    felt = FeltModel(machine)
    calibrator = Calibrator(felt, MachineLaw(machine, TorchStater(machine)))
    parameters = felt.parameters
    rng = np.random.default_rng(0)
    theta = parameters.prior_std * rng.standard_normal(len(parameters))
    built = SimulatedMachine(machine, parameters, theta)
    moving = QuasiStaticMachine(built, machine.reference, coefficient)
    unloaded = []
    before = machine.reference
    for _ in range(8):
        command = machine.reference + np.deg2rad(rng.uniform(-15.0, 15.0, len(before)))
        values = moving.go(command).values
        reading = machine.channels.read(np.tile(values, (50, 1)), rng).mean(axis=0)
        unloaded.append(Unloaded(reading, command, 50, 0, before))
        before = command
    calibration = calibrator.from_poses(unloaded)
    number = parameters.slices["friction"].start
    std = calibration.std[number]
    assert calibration.as_described
    assert std < 0.1 * parameters.prior_std[number]
    assert abs(calibration.mean[number] - coefficient) < 4.0 * std
