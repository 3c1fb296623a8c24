"""What is stated of a reading: contacts, faults, and what cannot be told apart."""

from pathlib import Path

import numpy as np
import pytest

from cablesense_contact.calibration import Calibrator, Unloaded
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.judgement import ContactState, Judge
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.built import BuiltArm, Push, Workmanship
from cablesense_sim.arm import open_arm
from cablesense_training.law.build import TorchLaw

FILE = open_arm("cdsm_lab")
ARM = FILE.model_copy(
    update={"tolerances": FILE.tolerances.model_copy(update={"friction_coefficient": 0.0})}
)
NOMINAL = read_nominal(Path("config/arms/cdsm_lab.yaml"))
COMMAND = np.deg2rad([4.0, -6.0, 5.0, 3.0, -7.0, 4.0, 6.0, -3.0])


class Bench:
    """A built arm, tared straight, and judged at a command."""

    def __init__(self):
        self.rng = np.random.default_rng(21)
        self.built = BuiltArm(NOMINAL, Workmanship(), np.random.default_rng(22))
        self.law = TorchLaw(ARM)
        self.judge = Judge(FeltArm(ARM))
        calibrator = Calibrator(FeltArm(ARM), self.law)
        straight = np.zeros(ARM.joint_count)
        tensions = self.built.tensions_n(straight)
        reading = self.built.read(np.tile(tensions, (50, 1)), self.rng).mean(axis=0)
        tared = calibrator.updated(calibrator.by_tolerances(), Unloaded(reading, straight, 50))
        self.known = calibrator.moved(tared)
        self.axes = self.built.axes(COMMAND)

    def push(self, segment, place_m, force_n):
        return Push(segment, place_m, self.axes[segment - 1] @ np.array(force_n, dtype=float))

    def reading(self, *pushes):
        return self.built.read(self.built.tensions_n(COMMAND, pushes), self.rng)

    def judged(self, reading_n):
        still = np.zeros((ARM.joint_count, ARM.joint_count))
        known = self.known
        seen = self.law(reading_n[None], COMMAND[None], known.mean, known.covariance, still)
        return self.judge(seen, reading_n), seen


@pytest.fixture(scope="module")
def bench():
    return Bench()


def test_an_untouched_arm_in_another_pose_than_its_tares_is_free(bench):
    judgement, _ = bench.judged(bench.reading())
    assert judgement.state is ContactState.FREE
    assert judgement.doubt == ""


@pytest.mark.parametrize("segment", [2, 3, 4])
def test_a_push_is_placed_and_its_force_lies_in_its_interval(bench, segment):
    judgement, seen = bench.judged(bench.reading(bench.push(segment, 0.06, [2.0, 12.0, -9.0])))
    assert judgement.state is ContactState.CONTACT
    assert judgement.segment == segment
    low_n, high_n = seen.magnitude_ci95_n[0]
    assert low_n - 0.3 < 15.0 < high_n + 0.3
    assert seen.place_m[0] == pytest.approx(0.06, abs=0.015)


def test_a_force_that_nothing_might_read_as_well_is_unconfirmed(bench):
    """A push that grows is free first, then doubted, then vouched for."""
    states = []
    for force_n in np.linspace(0.05, 0.25, 21):
        push = bench.push(3, 0.06, [0.0, force_n, 0.0])
        tensions_n = np.tile(bench.built.tensions_n(COMMAND, [push]), (400, 1))
        reading = bench.built.read(tensions_n, np.random.default_rng(1)).mean(axis=0)
        judgement, _ = bench.judged(reading)
        states.append(judgement.state)
        doubted = judgement.state is ContactState.UNCONFIRMED
        assert ("nothing touches" in judgement.doubt) == doubted
    in_order = [ContactState.FREE, ContactState.UNCONFIRMED, ContactState.CONTACT]
    assert list(dict.fromkeys(states)) == in_order


def test_a_force_outside_the_cone_of_friction_is_not_vouched_for(bench):
    """No single contact that presses and rubs makes it, and two on neighbouring segments do."""
    judgement, seen = bench.judged(bench.reading(bench.push(4, 0.06, [9.0, 12.0, -9.0])))
    assert judgement.state is ContactState.UNCONFIRMED
    assert "along the arm" in judgement.doubt
    assert seen.force_n[0, 0] > ARM.touch.friction * 15.0


def test_on_the_first_segment_the_moment_is_known_and_not_the_force(bench):
    judgement, seen = bench.judged(bench.reading(bench.push(1, 0.08, [0.0, 10.0, 20.0])))
    assert judgement.state is ContactState.MOMENT
    assert judgement.segment == 1
    np.testing.assert_allclose(seen.moment_n_m[0], [-1.6, 0.8], atol=0.1)


def test_a_wrong_channel_is_named_with_its_size_and_no_contact_is_stated(bench):
    reading = bench.reading()
    reading[4] += 25.0
    judgement, seen = bench.judged(reading)
    assert judgement.state not in (ContactState.CONTACT, ContactState.MOMENT)
    assert "cable_5 reads" in judgement.doubt
    assert seen.fault_n[0, 4] == pytest.approx(25.0, abs=2.0)


def test_exchanged_channels_are_named(bench):
    reading = bench.reading()
    reading[[0, 7]] = reading[[7, 0]]
    judgement, _ = bench.judged(reading)
    assert judgement.state not in (ContactState.CONTACT, ContactState.MOMENT)
    assert "cable_1 and cable_8 are exchanged" in judgement.doubt


def test_a_wrong_channel_beside_a_contact_is_not_vouched_for_while_it_misleads(bench):
    push = bench.push(3, 0.07, [0.0, 15.0, 0.0])
    for channel in range(ARM.cable_count):
        reading = bench.reading(push)
        reading[channel] += 20.0
        judgement, seen = bench.judged(reading)
        if judgement.state is ContactState.CONTACT:
            off_n = np.hypot(*(seen.force_n[0, 1:] - [15.0, 0.0]))
            assert judgement.segment == 3
            assert off_n < 5.0


def test_two_pushes_are_no_single_contact(bench):
    pushes = bench.push(2, 0.06, [0.0, 20.0, 0.0]), bench.push(4, 0.06, [0.0, 0.0, 18.0])
    judgement, _ = bench.judged(bench.reading(*pushes))
    assert judgement.state is ContactState.UNCONFIRMED
    assert "contact" in judgement.doubt


def test_a_higher_threshold_asks_for_more(bench):
    reading = bench.reading(bench.push(3, 0.07, [0.0, 0.2, 0.0]))
    _, seen = bench.judged(reading)
    assert Judge(FeltArm(ARM), 0.01)(seen, reading).state is not ContactState.FREE
    sure = Judge(FeltArm(ARM), 1.0 - 1e-12)(seen, reading).state
    assert sure not in (ContactState.CONTACT, ContactState.MOMENT)


def test_a_force_at_one_end_of_its_interval_is_not_known(bench):
    """Of a strong push on segment 1 only forces up to the largest that is expected count."""
    reading = bench.reading(bench.push(3, 0.06, [0.0, 12.0, -9.0]))
    _, seen = bench.judged(reading)
    size_n = float(np.hypot(*seen.force_n[0, 1:]))
    for low, high, state in (
        (0.8, 1.2, ContactState.CONTACT),
        (0.8, 1.02, ContactState.CONTACT),
        (0.5, 1.02, ContactState.MOMENT),
        (0.98, 1.5, ContactState.MOMENT),
    ):
        interval_n = size_n * np.array([[low, high]])
        assert bench.judge(seen._replace(magnitude_ci95_n=interval_n), reading).state is state
