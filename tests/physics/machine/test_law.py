"""What the law states of contacts on built machines: right links, and intervals that hold."""

from pathlib import Path

import numpy as np
import pytest

from cablesense_base import Array
from cablesense_contact.calibration import Calibrator, Unloaded
from cablesense_contact.judgement import ContactState, Judge
from cablesense_contact.law import LawOutput
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_contact.machine.law import MachineLaw
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce
from tests.helpers.example_machines import bent_command, example_machine, written_machine
from tests.helpers.torch_stater import TorchStater

CONTACTS = 60


class Trial:
    """Contacts on machines within tolerances, with what the law states of each."""

    def __init__(self, machine: Machine, seed: int, scale: float = 1.0) -> None:
        self.machine = machine
        self.law = MachineLaw(machine, TorchStater(machine))
        self.parameters = self.law.observer.parameters
        self.rng = np.random.default_rng(seed)
        self.mean = self.parameters.prior_mean
        self.std = scale * self.parameters.prior_std
        self.built: list[SimulatedMachine] = []

    def machine_as_built(self) -> SimulatedMachine:
        deviations = self.std * self.rng.standard_normal(len(self.std))
        return SimulatedMachine(self.machine, self.parameters, self.mean + deviations)

    def contact(self, link: int) -> tuple[float, LinkForce]:
        """Its place, and the force at the surface there."""
        links = self.machine.links
        touch = self.machine.source.file.touch
        place_m = float(self.rng.uniform(*links.touched_m[link]))
        inward = self.rng.uniform(0.0, 2.0 * np.pi)
        across = np.array([np.sin(inward), np.cos(inward)])
        lateral_n = touch.largest_n * self.rng.uniform(0.1, 0.6)
        along_n = lateral_n * touch.friction * self.rng.uniform(-1.0, 1.0)
        out_m = links.radius_m[link] * np.sqrt(self.rng.uniform())
        point_m = np.array([place_m, *(-out_m * across)])
        return place_m, LinkForce(link, point_m, np.append(along_n, lateral_n * across))

    def stated(self, readings: Array, commands: Array) -> LawOutput:
        count = len(self.machine.coordinates)
        still = np.zeros((count, count))
        covariance = np.diag(self.std**2)
        return self.law(readings, commands, self.mean, covariance, still)


@pytest.mark.parametrize(
    ("name", "links", "share_right"),
    [
        # a fingertip of 8 mm is a few deviations long: of 60 two in three, but for 1 in 1000
        ("finger", (1, 2), 0.47),
        ("seven_hinges", (4, 5, 6), 0.85),
        ("six_axis", (2, 3), 0.85),
    ],
)
def test_links_are_right_and_intervals_hold(
    name: str, links: tuple[int, ...], share_right: float
) -> None:
    machine = example_machine(name)
    trial = Trial(machine, seed=11)
    readings = []
    commands = []
    truth = []
    for number in range(CONTACTS):
        command = bent_command(machine, seed=100 + number)
        built = trial.machine_as_built()
        place_m, contact = trial.contact(links[number % len(links)])
        rest = built.touched(command, (contact,), built.untouched(command))
        readings.append(machine.channels.read(rest.values, trial.rng))
        commands.append(command)
        truth.append((contact.link, place_m, float(np.hypot(*contact.force_n[1:]))))
    seen = trial.stated(np.array(readings), np.array(commands))
    link, place_m, lateral_n = np.array(truth).T
    reached = machine.links.touched_m
    before_m = np.cumsum(reached[:, 1] - reached[:, 0]) - reached[:, 1]
    along_m = before_m[link.astype(int)] + place_m
    right = seen.contact_evidence.argmax(axis=1) == link
    in_region = (seen.region_m[:, 0] <= along_m) & (along_m <= seen.region_m[:, 1])
    low_n, high_n = seen.magnitude_ci95_n.T
    in_force = (low_n <= lateral_n) & (lateral_n <= high_n)
    assert right.mean() > share_right
    # of 60 right with 95 % more than 52 hold, but for 1 in 1000
    assert in_region.mean() > 52.0 / 60.0
    assert in_force.mean() > 52.0 / 60.0


def test_where_a_moment_alone_is_told_the_force_is_that_of_any_link() -> None:
    """Across a finger one hinge feels: the interval holds the force on either phalanx."""
    machine = example_machine("finger")
    trial = Trial(machine, seed=15, scale=0.0)
    command = machine.reference
    built = trial.machine_as_built()
    untouched = built.untouched(command)
    readings = []
    pushed_n = []
    for link, lateral_n in ((1, 0.4), (2, 0.35)):
        place_m = float(machine.links.touched_m[link].mean())
        contact = LinkForce(link, np.array([place_m, 0.0, 0.0]), np.array([0.0, lateral_n, 0.0]))
        rest = built.touched(command, (contact,), untouched)
        readings.append(machine.channels.read(rest.values, trial.rng))
        pushed_n.append(lateral_n)
    seen = trial.stated(np.array(readings), np.tile(command, (2, 1)))
    low_n, high_n = seen.magnitude_ci95_n.T
    assert (low_n < pushed_n).all()
    assert (pushed_n < high_n).all()
    # a push on the first phalanx with the same moment is more than twice as hard
    assert (high_n > 2.0 * np.array(pushed_n)).all()


@pytest.mark.parametrize("name", ["finger", "seven_hinges", "hand", "continuum", "six_axis"])
def test_an_untouched_machine_within_tolerances_is_not_touched(name: str) -> None:
    machine = example_machine(name)
    trial = Trial(machine, seed=12)
    readings = []
    commands = []
    for number in range(5):
        command = bent_command(machine, seed=200 + number, reach_deg=4.0)
        built = trial.machine_as_built()
        readings.append(machine.channels.read(built.untouched(command).values, trial.rng))
        commands.append(command)
    seen = trial.stated(np.array(readings), np.array(commands))
    assert seen.contact_evidence.max() < 0.0
    assert seen.free_chi2.max() < 4.0 * len(machine.channels.names) + 10.0


def test_a_touch_near_the_tip_of_a_soft_machine_is_found_where_tensions_tell() -> None:
    """Eight tensions of forty hinges: the far cables tell place and force beyond the near ones."""
    machine = example_machine("continuum")
    trial = Trial(machine, seed=13, scale=1e-3)
    command = bent_command(machine, seed=300, reach_deg=2.0)
    built = trial.machine_as_built()
    untouched = built.untouched(command)
    contact = LinkForce(17, np.array([0.010, 0.0, 0.0]), np.array([0.0, 0.6, -0.8]))
    rest = built.touched(command, (contact,), untouched)
    assert np.rad2deg(np.abs(rest.pose - untouched.pose).max()) > 0.2
    reading = machine.channels.read(rest.values, trial.rng)
    seen = trial.stated(reading[None], command[None])
    assert seen.contact_evidence[0].argmax() == contact.link
    assert seen.place_m[0] == pytest.approx(0.010, abs=0.002)
    np.testing.assert_allclose(seen.force_n[0, 1:], contact.force_n[1:], atol=0.02)


def test_a_touch_before_the_near_station_leaves_place_and_force_open() -> None:
    """There four numbers would have to follow from the two that its bending moments are."""
    machine = example_machine("continuum")
    trial = Trial(machine, seed=14, scale=1e-3)
    command = bent_command(machine, seed=301, reach_deg=2.0)
    built = trial.machine_as_built()
    contact = LinkForce(1, np.array([0.005, 0.0, 0.0]), np.array([0.0, 0.6, -0.8]))
    rest = built.touched(command, (contact,), built.untouched(command))
    reading = machine.channels.read(rest.values, trial.rng)
    seen = trial.stated(reading[None], command[None])
    low_m, high_m = seen.region_m[0]
    low_n, high_n = seen.magnitude_ci95_n[0]
    assert low_m <= 0.015 + 0.005 <= high_m
    assert low_n <= 1.0 <= high_n
    assert high_n - low_n > 0.3


PLANAR_MODEL = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <site name="left_base" pos="-0.05 0 0.02"/>
    <site name="right_base" pos="-0.05 0 -0.02"/>
    <body name="lever">
      <joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.01" contype="0" conaffinity="0"/>
      <site name="left_end" pos="0.1 0 0.02"/>
      <site name="right_end" pos="0.1 0 -0.02"/>
    </body>
  </worldbody>
  <tendon>
    <spatial name="left"><site site="left_base"/><site site="left_end"/></spatial>
    <spatial name="right"><site site="right_base"/><site site="right_end"/></spatial>
  </tendon>
  <actuator>
    <position name="left_drive" tendon="left" kp="1e5"/>
    <position name="right_drive" tendon="right" kp="1e5"/>
  </actuator>
</mujoco>
"""
PLANAR_FILE = """
joints: commanded
sensors:
  tension: {of: [left, right], noise_std: 0.05}
cables: {pretension_n: 100}
touch:
  largest_n: 20
  links:
    - {link: lever, start_m: [0.299, 0, 0], end_m: [0.301, 0, 0]}
"""


def test_two_tendons_tell_the_force_in_their_plane_where_the_place_is_known(
    tmp_path: Path,
) -> None:
    """What acts along the hinge is not felt: it is not stated, and its deviation stays open."""
    machine = written_machine(tmp_path, PLANAR_MODEL, PLANAR_FILE)
    trial = Trial(machine, seed=15, scale=1e-3)
    command = np.zeros(1)
    built = trial.machine_as_built()
    contact = LinkForce(0, np.array([0.3, 0.0, 0.0]), np.array([0.0, 7.0, 4.0]))
    rest = built.touched(command, (contact,), built.untouched(command))
    seen = trial.stated(rest.values[None], command[None])
    std_n = np.sqrt(np.diagonal(seen.contact_covariance[0]))[1:]
    assert seen.force_n[0, 2] == pytest.approx(4.0, abs=0.1)
    assert std_n[2] < 0.1
    assert std_n[1] > 5.0
    assert seen.force_n[0, 1] == pytest.approx(0.0, abs=1e-6)
    low_n, high_n = seen.magnitude_ci95_n[0]
    assert low_n < 4.0 < high_n
    assert high_n - low_n < 0.4
    judgement = Judge(FeltModel(machine))(seen, rest.values)
    assert judgement.state is ContactState.CONTACT


def test_a_soft_machine_that_was_tared_straight_is_untouched_in_other_poses() -> None:
    """Its forty hinges give way to eight tensions; no push may explain what tolerances make."""
    machine = example_machine("continuum")
    trial = Trial(machine, seed=17)
    calibrator = Calibrator(FeltModel(machine), trial.law)
    straight = Holding(machine).command_of(machine.reference)
    still = np.zeros((len(machine.coordinates), len(machine.coordinates)))
    misfits = []
    for number in range(8):
        built = trial.machine_as_built()
        tare_n = machine.channels.read(built.untouched(straight).values, trial.rng)
        known = calibrator.updated(calibrator.by_tolerances(), Unloaded(tare_n, straight, 1))
        command = bent_command(machine, seed=400 + number, reach_deg=10.0)
        reading = machine.channels.read(built.untouched(command).values, trial.rng)
        seen = trial.law(reading[None], command[None], known.mean, known.covariance, still)
        assert seen.contact_evidence.max() < 0.0
        misfits.append(seen.free_chi2[0])
    # of 64 numbers; more than 100 but for 1 in 1000
    assert np.sum(misfits) < 105.0


@pytest.mark.parametrize("link", [3, 6, 11])
def test_a_firm_push_on_a_soft_machine_is_found_where_it_is(link: int) -> None:
    """It bends the machine by ten degrees: what is linear about the untouched one is far off."""
    machine = example_machine("continuum")
    trial = Trial(machine, seed=18, scale=0.1)
    command = bent_command(machine, seed=500 + link, reach_deg=10.0)
    built = trial.machine_as_built()
    untouched = built.untouched(command)
    contact = LinkForce(link, np.array([0.008, 0.0, 0.0]), np.array([0.0, 1.8, 2.2]))
    rest = built.touched(command, (contact,), untouched)
    assert np.rad2deg(np.abs(rest.pose - untouched.pose).max()) > 8.0
    reading = machine.channels.read(rest.values, trial.rng)
    seen = trial.stated(reading[None], command[None])
    along_m = 0.015 * link + 0.008
    low_m, high_m = seen.region_m[0]
    assert low_m < along_m < high_m
    assert high_m - low_m < 0.09


@pytest.mark.slow
def test_a_soft_machine_is_calibrated_by_what_its_untouched_poses_read() -> None:
    """Its fit is as good as the sensors are, and a light push is then known to a tenth."""
    machine = example_machine("continuum")
    trial = Trial(machine, seed=19)
    calibrator = Calibrator(FeltModel(machine), trial.law)
    built = trial.machine_as_built()
    unloaded = []
    for number in range(4):
        command = bent_command(machine, seed=600 + number)
        values = np.tile(built.untouched(command).values, (50, 1))
        mean_n = machine.channels.read(values, trial.rng).mean(axis=0)
        unloaded.append(Unloaded(mean_n, command, 50))
    known = calibrator.from_poses(unloaded)
    assert known.as_described
    command = bent_command(machine, seed=700)
    contact = LinkForce(17, np.array([0.008, 0.0, 0.0]), np.array([0.0, 0.4, -0.45]))
    rest = built.touched(command, (contact,), built.untouched(command))
    reading = machine.channels.read(rest.values, trial.rng)
    still = np.zeros((len(machine.coordinates), len(machine.coordinates)))
    seen = trial.law(reading[None], command[None], known.mean, known.covariance, still)
    assert abs(int(seen.contact_evidence[0].argmax()) - contact.link) <= 1
    assert np.hypot(*seen.force_n[0, 1:]) == pytest.approx(np.hypot(0.4, 0.45), rel=0.1)
