"""The commissioning of arms of the independent plant, with the law in PyTorch; no ROS."""

from pathlib import Path

import numpy as np
import pytest

from cablesense_base.installation import config_path
from cablesense_contact.calibration import Calibrator, Unloaded
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.reference_contacts import ReferenceContacts
from cablesense_online.chosen_poses import PoseError, chosen_poses
from cablesense_online.commissioning import (
    Commissioning,
    CommissioningRefusedError,
    CommissioningSettings,
    Stage,
    expected_duration_s,
    visits,
)
from cablesense_online.movable import taut
from cablesense_online.movable_arm import MovableArm, approach_direction
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.built import BuiltArm, Push, Workmanship
from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from tests.helpers.arm_variants import variant

LAB = Path(config_path("arms/cdsm_lab.yaml"))
POSES = 25
BEND_RAD = float(np.deg2rad(10.0))
NS = 1_000_000_000
STEP_S = 0.2


def law_of(arm):
    from cablesense_training.law.build import TorchLaw

    return TorchLaw(arm)


@pytest.fixture(scope="module")
def lab():
    """The laboratory's arm, its law, and its chosen poses."""
    arm = open_arm(LAB)
    tolerances = arm.tolerances.model_copy(update={"friction_coefficient": 0.0})
    arm = arm.model_copy(update={"tolerances": tolerances})
    law = law_of(arm)
    return arm, law, chosen_poses(MovableArm(arm, law), law, POSES, BEND_RAD)


@pytest.fixture(scope="module")
def built():
    """An arm built with a workshop's tolerances, which no file states."""
    return BuiltArm(read_nominal(LAB), Workmanship(), np.random.default_rng(11))


class Bench:
    """Plays a commissioning against an arm, sample by sample."""

    def __init__(self, commissioning, built, seed=0):
        self.commissioning = commissioning
        self.built = built
        self.pushes = ()
        self.commands = []
        self.now_ns = 0
        self._rng = np.random.default_rng(seed)
        self._command_rad = None
        self._tensions = {}

    def run(self, until, silent=False, limit_s=1000.0):
        """Go on until something is true; gives the time that passed, s."""
        begun_ns = self.now_ns
        while not until(self.commissioning):
            self.now_ns += round(STEP_S * NS)
            assert self.now_ns - begun_ns < limit_s * NS
            sent = self.commissioning.advance(self.now_ns)
            if sent is not None:
                self.commands.append(sent)
                self._command_rad = sent
            if not silent and self.commissioning.stage is Stage.HOLDING:
                self.commissioning.take(self._reading_n(), self.now_ns)
            elif not silent:
                self.commissioning.take(np.full(12, 50.0), self.now_ns)
        return (self.now_ns - begun_ns) / NS

    def _reading_n(self):
        key = self._command_rad.tobytes(), bool(self.pushes)
        if key not in self._tensions:
            self._tensions[key] = self.built.tensions_n(self._command_rad, self.pushes)
        return self.built.read(self._tensions[key], self._rng)


def over(commissioning):
    return commissioning.over


def commissioned(lab, built, count=None, **settings):
    arm, law, poses = lab
    given = CommissioningSettings(**{"readings": 10, "silent_after_s": 2.0, **settings})
    start = np.zeros(arm.joint_count)
    movable = MovableArm(arm, law)
    rate_hz = arm.sensors.rate_hz
    return Bench(Commissioning(movable, law, poses[:count], start, 0, rate_hz, given), built)


def force_known_n(arm, law, poses):
    """What contacts will be known to, after these poses."""
    calibrator = Calibrator(FeltArm(arm), law)
    readings = MovableArm(arm, law).predicted_n(poses, calibrator.by_tolerances())
    unloaded = [Unloaded(*both, 20) for both in zip(readings, poses, strict=True)]
    calibration = calibrator.moved(calibrator.from_poses(unloaded))
    contacts = ReferenceContacts.of_arm(arm)
    return contacts.known_force(law, calibration.mean, calibration.covariance).half_interval_n


@pytest.mark.slow
def test_chosen_poses_teach_more_than_random_ones(lab):
    arm, law, poses = lab
    chosen_n = force_known_n(arm, law, poses)
    rng = np.random.default_rng(5)
    random_n = [
        force_known_n(arm, law, rng.uniform(-0.1745, 0.1745, poses.shape)) for _ in range(3)
    ]
    assert chosen_n < 0.98 * min(random_n)
    assert chosen_n < 0.2


def test_chosen_poses_are_within_the_range_taut_and_near_one_another(lab):
    arm, law, poses = lab
    assert poses.shape == (25, arm.joint_count)
    assert len(np.unique(poses, axis=0)) == 25
    assert np.abs(poses).max() <= np.deg2rad(10.0)
    prior = Calibrator(FeltArm(arm), law).by_tolerances()
    movable = MovableArm(arm, law)
    assert movable.predicted_n(poses, prior).min() > 10.0
    assert taut(movable, poses, prior).all()
    turns = np.abs(np.diff(poses, axis=0)).max(axis=1)
    shuffled = np.random.default_rng(0).permutation(poses)
    assert turns.sum() < np.abs(np.diff(shuffled, axis=0)).max(axis=1).sum()


def test_poses_are_refused_where_cables_get_slack(lab):
    arm, _, _ = lab
    slack = arm.model_copy(update={"cables": arm.cables.model_copy(update={"pretension_n": 8.0})})
    with pytest.raises(PoseError, match="above 20% of their pretension; 25 are needed"):
        chosen_poses(MovableArm(slack, law_of(slack)), law_of(slack), POSES, BEND_RAD)


@pytest.mark.slow
def test_as_many_poses_are_chosen_as_the_commissioner_may_be_asked_for():
    arm = variant({"segments.count": 2}, "cdsm_lab")
    law = law_of(arm)
    most = 200
    poses = chosen_poses(MovableArm(arm, law), law, most, BEND_RAD)
    assert len(np.unique(poses, axis=0)) == most


def test_predicted_readings_are_those_of_the_equilibrium(lab):
    from cablesense_sim.equilibrium import solve_equilibrium

    arm, law, poses = lab
    predicted_n = MovableArm(arm, law).predicted_n(
        poses, Calibrator(FeltArm(arm), law).by_tolerances()
    )
    rest = solve_equilibrium(mechanism_of(arm), poses)
    np.testing.assert_allclose(predicted_n, rest.tensions_n, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cdsm", "cdsm_lab", "cdsm_friction"])
def test_a_commissioning_takes_less_than_five_minutes(name):
    arm = open_arm(name)
    settings = CommissioningSettings()
    movable = MovableArm(arm, law_of(arm))
    poses = chosen_poses(movable, law_of(arm), POSES, BEND_RAD)
    stops = visits(movable, poses, settings)
    assert len(stops) == (50 if name == "cdsm_friction" else 25)
    speed = settings.joint_speed_rad_s
    taken_s = expected_duration_s(stops, settings, np.zeros(8), arm.sensors.rate_hz, speed)
    assert 30.0 < taken_s < 300.0


@pytest.mark.slow
def test_a_built_arm_is_known_after_its_commissioning(lab, built):
    arm, law, _ = lab
    bench = commissioned(lab, built)
    before = bench.commissioning.progress
    assert before.holds == 25
    assert before.holds_done == 0
    assert before.known_force.half_interval_n > 0.8
    taken_s = bench.run(over)
    done = bench.commissioning
    assert done.stage is Stage.DONE, done.problem
    assert done.problem == ""
    # moves end at the next step of this test's clock, two of them each hold
    assert before.remaining_s - 1.0 < taken_s < before.remaining_s + 25 * 2.5 * STEP_S
    assert done.progress.holds_done == 25
    assert done.progress.remaining_s == 0.0
    assert done.progress.known_force.half_interval_n < 0.2
    assert "25 of 25 holds" in done.progress.text
    np.testing.assert_array_equal(bench.commands[-1], np.zeros(8))
    assert done.calibration.made_from == "a commissioning in 25 poses"
    assert done.calibration.as_described
    assert done.calibration.last_unloaded_ns > 0
    # readings in another pose are now predicted
    elsewhere = np.deg2rad(np.random.default_rng(3).uniform(-9.0, 9.0, (5, 8)))
    true_n = built.rests(elsewhere, [()] * 5).tensions_n * built.gains + built.zeros_n
    movable = MovableArm(arm, law)
    prior = Calibrator(FeltArm(arm), law).by_tolerances()
    off_before = np.abs(movable.predicted_n(elsewhere, prior) - true_n)
    off_after = np.abs(movable.predicted_n(elsewhere, done.calibration) - true_n)
    assert off_after.mean() < 0.1 * off_before.mean()
    assert off_after.max() < 1.0


def test_a_contact_stops_it_and_the_arm_holds_its_pose(lab, built):
    bench = commissioned(lab, built, count=6)
    bench.run(lambda c: c.progress.holds_done == 4 and c.stage is Stage.ARRIVING)
    bench.run(lambda c: c.stage is Stage.HOLDING)
    pose = bench.commissioning.sent_rad
    axis = built.axes(pose)[2]
    bench.pushes = (Push(3, 0.065, axis @ np.array([0.0, 12.0, 0.0])),)
    bench.run(over)
    stopped = bench.commissioning
    assert stopped.stage is Stage.STOPPED
    assert "touches segment 3, with about 1" in stopped.problem
    bench.now_ns += NS
    np.testing.assert_allclose(stopped.advance(bench.now_ns), pose)
    assert stopped.advance(bench.now_ns) is None
    assert len(stopped.calibration.unloaded) == 4


def test_a_short_knock_does_not_stop_it(lab, built):
    bench = commissioned(lab, built, count=3)
    bench.run(lambda c: c.progress.holds_done == 1 and c.stage is Stage.ARRIVING)
    bench.run(lambda c: c.stage is Stage.HOLDING)
    bench.pushes = (Push(3, 0.065, np.array([0.0, 12.0, 0.0])),)
    knocked_ns = bench.now_ns + round(0.75 * NS)  # half a second to settle, and two readings
    bench.run(lambda c: bench.now_ns >= knocked_ns)
    bench.pushes = ()
    bench.run(over)
    assert bench.commissioning.stage is Stage.DONE, bench.commissioning.problem
    assert bench.commissioning.calibration.as_described


def test_a_wrong_channel_stops_it(lab, built):
    bench = commissioned(lab, built, count=6)
    bench.run(lambda c: c.progress.holds_done == 3)
    gains = built.gains.copy()
    try:
        built.gains[4] *= 0.6
        bench.run(over)
    finally:
        built.gains[:] = gains
    assert bench.commissioning.stage is Stage.STOPPED
    assert "not those of the untouched arm" in bench.commissioning.problem


def test_what_it_computes_itself_is_no_silence(lab, built):
    """Whoever calls it had no time to give it readings; a silence after that still ends it."""
    bench = commissioned(lab, built, count=6, silent_after_s=1.0, joint_speed_rad_s=0.02)
    bench.run(lambda c: c.stage is Stage.ARRIVING)
    bench.now_ns += 3 * NS
    bench.commissioning.advance(bench.now_ns)
    assert not bench.commissioning.over
    assert bench.run(over, silent=True) == pytest.approx(1.0, abs=0.2)
    assert bench.commissioning.problem.startswith("no reading for 1.")


def test_silence_stops_it_on_the_way(lab, built):
    bench = commissioned(lab, built, count=6, silent_after_s=1.0, joint_speed_rad_s=0.02)
    bench.run(lambda c: c.stage is Stage.ARRIVING)
    going_to = bench.commissioning.sent_rad
    bench.run(over, silent=True)
    assert bench.commissioning.problem.startswith("no reading for 1.")
    held = bench.commissioning.advance(bench.now_ns)
    held = bench.commands[-1] if held is None else held
    assert np.abs(held - going_to).max() > 1e-4  # it had not arrived yet
    assert np.abs(held - going_to).max() < np.deg2rad(2.0)


def test_readings_that_never_rest_stop_it(lab, built):
    bench = commissioned(lab, built, count=3)
    bench.run(lambda c: c.stage is Stage.HOLDING)
    commissioning = bench.commissioning
    while not commissioning.over:
        bench.now_ns += round(STEP_S * NS)
        commissioning.advance(bench.now_ns)
        commissioning.take(np.full(12, 50.0), 1)  # of before the hold
        commissioning._heard_ns = bench.now_ns
    assert "no 10 steady readings" in commissioning.problem


def test_one_who_takes_over_is_given_way(lab, built):
    bench = commissioned(lab, built, count=3)
    bench.run(lambda c: c.stage is Stage.ARRIVING)
    bench.commissioning.give_way("another node commands the arm")
    assert bench.commissioning.over
    assert bench.commissioning.advance(bench.now_ns + NS) is None
    assert "another node" in bench.commissioning.problem


def test_without_poses_there_is_none(lab, built):
    with pytest.raises(CommissioningRefusedError, match="at least one pose"):
        commissioned(lab, built, count=0)


def test_poses_are_reached_from_two_sides_and_with_friction_each_from_both():
    arm = open_arm("cdsm_lab")
    poses = np.deg2rad(np.random.default_rng(0).uniform(-5.0, 5.0, (4, 8)))
    settings = CommissioningSettings(approach_rad=0.02)
    once = visits(MovableArm(arm, None), poses, settings)
    sides = np.array([visit.beside_rad - visit.pose_rad for visit in once])
    np.testing.assert_allclose(sides[0::2], -sides[1::2])
    assert np.abs(sides).max() == pytest.approx(0.02)
    twice = visits(MovableArm(open_arm("cdsm_friction"), None), poses, settings)
    assert len(twice) == 8
    np.testing.assert_allclose(twice[0].pose_rad, twice[1].pose_rad)
    beside = twice[0].beside_rad - twice[0].pose_rad
    np.testing.assert_allclose(twice[1].beside_rad - twice[1].pose_rad, -beside)
    asked = CommissioningSettings(both_sides=True)
    assert len(visits(MovableArm(arm, None), poses, asked)) == 8


def test_every_cable_moves_at_every_guide_on_the_approach():
    mechanism = mechanism_of(open_arm("cdsm"))
    direction = approach_direction(mechanism)
    assert np.abs(direction).max() == 1.0
    for guide in range(4):
        beyond = np.where(np.arange(8) // 2 >= guide, direction, 0.0)
        moved_m = np.abs(kinematics.cable_jacobian_m(mechanism, np.zeros(8)) @ beyond)
        # of 50 mm, the radius at which cables run
        assert moved_m[mechanism.passes_joint[:, guide]].min() > 0.005
