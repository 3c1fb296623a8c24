"""Contacts anywhere, through the estimation: place, force, or the moment alone."""

from dataclasses import replace

import numpy as np
import pytest
from arm_at_rest import BENT, STRAIGHT, Arm, mechanism_of, solve_equilibrium

from cablesense_msgs_py.messages import ForceState, Level
from cablesense_sim import kinematics
from cablesense_sim.replay import read_tensions_n

pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark

FIRM_N = {"cdsm": 40.0, "cdsm_lab": 20.0}


class Pushed(Arm):
    """An arm pushed at any place, by forces along the axes of the segments at the command."""

    def __init__(self, name, command, model=""):
        super().__init__(name, command, model=model or f"{name}_anywhere")
        self.mechanism = mechanism_of(self.arm)

    def push(self, *pushes, samples=3):
        """The answer to the last of some samples under pushes (segment, place, x, y, z)."""
        at_m, forces = self.mechanism.contact_m.copy(), np.zeros((4, 3))
        axes = kinematics.segment_rotations(self.mechanism, self.command)
        for segment, place_m, *force_n in pushes:
            at_m[segment - 1] = place_m
            forces[segment - 1] = axes[segment - 1] @ force_n
        touched = replace(self.mechanism, contact_m=at_m)
        self.loaded_n = solve_equilibrium(touched, self.command, forces).tensions_n
        return [self.read(self.loaded_n) for _ in range(samples)][-1]

    def read(self, tensions_n):
        return self.sample(np.maximum(read_tensions_n(tensions_n, self.arm.sensors, self.rng), 0))

    def release(self):
        return [self.sample() for _ in range(30)][-1]


@pytest.fixture(scope="module", params=FIRM_N)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def straight(name):
    return Pushed(name, STRAIGHT)


@pytest.fixture(scope="module")
def bent(name):
    return Pushed(name, BENT)


@pytest.fixture(params=["straight", "bent"])
def arm(request):
    arm = request.getfixturevalue(request.param)
    yield arm
    assert arm.release().force is ForceState.FREE


@pytest.mark.parametrize("segment", [2, 3, 4])
@pytest.mark.parametrize("place_m", [0.02, 0.066, 0.1, 0.128])
def test_a_push_anywhere_beyond_segment_1_is_a_contact_there(arm, name, segment, place_m):
    size_n, angle_deg = 0.3 * FIRM_N[name], 35.0
    y, z = size_n * np.sin(np.deg2rad(angle_deg)), size_n * np.cos(np.deg2rad(angle_deg))
    answer = arm.push((segment, place_m, 0.0, y, z))
    assert answer.force in (ForceState.CONTACT, ForceState.UNCONFIRMED)
    contact = answer.contact
    assert contact.segment == segment or abs(place_m - 0.13) < 0.01
    if contact.segment == segment:
        low_m, high_m = answer.region_m
        assert low_m - 0.002 <= place_m <= high_m + 0.002
        assert contact.contact_m == pytest.approx(place_m, abs=0.006)
        assert contact.magnitude_n == pytest.approx(size_n, abs=max(0.6, 0.05 * size_n))
        assert contact.angle_deg == pytest.approx(angle_deg, abs=3.0)
        moment_n_m = contact.wrench[3:]
        assert moment_n_m == pytest.approx([0.0, -place_m * z, place_m * y], abs=0.03)


@pytest.mark.parametrize("place_m", [0.03, 0.065, 0.11])
def test_on_segment_1_the_moment_is_stated_and_no_force(arm, name, place_m):
    size_n = 0.5 * FIRM_N[name]
    answer = arm.push((1, place_m, 0.0, 0.0, size_n))
    assert answer.force in (ForceState.MOMENT, ForceState.UNCONFIRMED)
    force_n, moment_n_m = np.array(answer.wrench("zero")).reshape(2, 3)
    assert not force_n.any()
    assert moment_n_m == pytest.approx([0.0, -size_n * place_m, 0.0], abs=0.05)
    lower, upper = answer.bounds
    assert lower.magnitude_n < size_n < upper.magnitude_n
    assert upper.contact_m < lower.contact_m


def test_the_axial_force_is_stated_where_the_pose_shows_it(bent, name):
    size_n = 0.5 * FIRM_N[name]
    answer = bent.push((4, 0.06, 0.4 * size_n, size_n, 0.0))
    assert answer.contact.along_n == pytest.approx(0.4 * size_n, abs=2.0)
    assert answer.contact.wrench[0] == answer.contact.along_n
    bent.release()


def test_two_contacts_are_told_from_one(bent, name):
    size_n = 0.4 * FIRM_N[name]
    answer = bent.push((2, 0.07, 0.0, size_n, 0.0), (4, 0.09, 0.0, 0.0, size_n))
    assert sorted(contact.segment for contact in answer.contacts) == [2, 4]
    bent.release()


def test_two_contacts_are_not_vouched_for_while_the_arm_settles():
    arm = Pushed("cdsm", STRAIGHT)
    pushes = (2, 0.07, 0.0, 32.0, 0.0), (4, 0.09, 0.0, -10.9, -30.1)
    assert arm.push(*pushes).force is ForceState.CONTACT
    arm.release()
    arm.estimation.gate.state.turned_ns = arm.now_ns
    assert arm.push(*pushes).force is ForceState.UNCONFIRMED
    assert "motion of the arm" in arm.estimation.plausibility.status().message


def test_a_push_on_segment_1_beside_one_on_segment_2_is_not_vouched_for(bent, name):
    size_n = 0.4 * FIRM_N[name]
    answer = bent.push((1, 0.11, 0.0, 0.0, -2.0 * size_n), (2, 0.05, 0.0, 0.3 * size_n, size_n))
    assert answer.force is ForceState.UNCONFIRMED
    status = bent.estimation.plausibility.status()
    assert status.level is Level.WARN
    assert "readings fit, but" in status.message
    bent.release()


@pytest.mark.parametrize("cables", [[0, 1], [0, 2], [1, 2]])
def test_a_pair_of_faults_that_looks_like_a_moment_on_segment_1_is_named(straight, cables):
    reading = straight.estimation.tares.present.measured_n.copy()
    reading[cables] += [15.0, -15.0]
    answers = [straight.read(reading) for _ in range(3)]
    assert {answer.force for answer in answers} == {ForceState.UNCONFIRMED}
    names = " and ".join(f"cable_{cable + 1}" for cable in cables)
    assert f"wrong readings of {names}" in straight.estimation.plausibility.status().message
    straight.release()


@pytest.mark.parametrize("scale", [0.5, 0.9, 1.1, 2.0])
def test_a_scaled_channel_makes_no_wrong_force_that_is_vouched_for(bent, name, scale):
    for cable in range(12):
        for segment, place_m in ((2, 0.03), (4, 0.06)):
            size_n = 0.5 * FIRM_N[name]
            bent.push((segment, place_m, 0.0, 0.0, size_n), samples=1)
            reading = bent.loaded_n.copy()
            reading[cable] *= scale
            answers = [bent.read(np.maximum(reading, 0.0)) for _ in range(3)]
            for answer in answers:
                if answer.force is ForceState.CONTACT:
                    contact = answer.contact
                    assert contact.segment == segment
                    y, z = (contact.magnitude_n * part for part in contact.direction)
                    assert np.hypot(y, z - size_n) < 5.0
    bent.release()


@pytest.mark.parametrize("segment", [1, 2])
def test_the_average_of_a_steady_push_confirms_it_and_a_wrong_reading_is_not_vouched_for(segment):
    """One sample of these pushes cannot exclude that a reading of cable_1 is wrong by newtons."""
    arm, push = Pushed("cdsm", BENT), (segment, 0.07, 0.0, 80.0, 0.0)
    first, last = arm.push(push), arm.push(push, samples=20)
    assert first.force is ForceState.UNCONFIRMED
    assert last.force in (ForceState.CONTACT, ForceState.MOMENT)
    true = np.array(last.contact.wrench)
    for off_n in (0.5, 1.0, 2.0, 5.0):
        arm.release()
        arm.loaded_n[0] += off_n
        answer = [arm.read(arm.loaded_n) for _ in range(20)][-1]
        arm.loaded_n[0] -= off_n
        if answer.force in (ForceState.CONTACT, ForceState.MOMENT):
            _, *normal_n, _, moment_y, moment_z = np.array(answer.contact.wrench) - true
            assert np.hypot(*normal_n) < 5.0
            assert np.hypot(moment_y, moment_z) / 0.07 < 5.0


NEARLY_SLACK = {
    "a cable pulls by less than its reading shows": (
        *("cdsm_lab", "cdsm_lab_anywhere", [1.71, 9.45, -0.33, 9.46, -4.15, 2.71, -9.19, -4.02]),
        *((4, 0.0388, 0.0, 75.9, 69.96), 103.2),
    ),
    "a joint is free between two cables": (
        *("cdsm_lab", "cdsm_lab", [-3.59, -8.12, 6.7, 4.19, 9.79, 7.19, -0.29, 1.41]),
        *((4, 0.065, 0.0, -137.68, 3.21), 137.7),
    ),
    "the estimate is far from the contact that fits": (
        *("cdsm_lab", "cdsm_lab_anywhere", [4.32, 6.22, -6.86, 9.77, 4.36, 7.68, -4.6, -9.45]),
        *((2, 0.0298, 0.0, -113.09, -144.67), None),
    ),
}


@pytest.mark.parametrize(
    ("name", "model", "command_deg", "push", "size_n"),
    NEARLY_SLACK.values(),
    ids=list(NEARLY_SLACK),
)
def test_a_contact_with_a_nearly_slack_cable_is_stated(name, model, command_deg, push, size_n):
    """Without its length the others determine the pose badly, and the model's misfit is large."""
    arm = Pushed(name, np.deg2rad(command_deg), model)
    answers = [arm.push(push, samples=1) for _ in range(40)]
    expected = {ForceState.CONTACT, ForceState.UNCONFIRMED} if size_n else {ForceState.UNCONFIRMED}
    assert {answer.force for answer in answers} <= expected
    assert arm.loaded_n[arm.loaded_n > 0.01].min() < 0.25
    if size_n:
        found_n = [answer.contact.magnitude_n for answer in answers]
        assert found_n == pytest.approx([size_n] * 40, abs=1.0)
