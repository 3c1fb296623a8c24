"""A force only from readings that fit it: faults are withheld, contacts are not; the limit."""

from dataclasses import replace

import numpy as np
import pytest
from arm_at_rest import BENT, PERIOD_NS, STRAIGHT, Arm, loaded_model, push

from cablesense_base.installation import config_path
from cablesense_msgs_py.messages import NO_CONTACT, ForceState, Level
from cablesense_online import misfit_limit
from cablesense_online.misfit_limit import put_simulated_limit, simulated_misfits
from cablesense_online.models import LoadedModel
from cablesense_online.plausibility import LEAST_WITHHELD_S, WITHHELD_S
from cablesense_online.samples import ProblemKind
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.replay import read_tensions_n
from cablesense_training.errors import ModelFileError
from cablesense_training.inference.metadata import MisfitLimit
from cablesense_training.inference.model_file import replace_misfit_limit

pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark


def off_n(contact, segment, angle_deg, magnitude_n):
    """How far a contact's force is from the true one."""
    if contact.segment != segment:
        return max(contact.magnitude_n, magnitude_n)
    true = magnitude_n * np.exp(1j * np.deg2rad(angle_deg))
    return abs(contact.magnitude_n * np.exp(1j * np.deg2rad(contact.angle_deg)) - true)


def most_off_n(answer, told):
    """How far the worst of several contacts is from the true force on its segment."""
    found = {contact.segment: contact for contact in answer.contacts}
    return max(
        off_n(found.get(segment, NO_CONTACT), segment, *told.get(segment, (0.0, 0.0)))
        for segment in {*found, *told}
    )


def scaled(scale):
    def fault(reading, cable):
        reading[cable] *= scale

    return fault


def reads(value):
    def fault(reading, cable):
        reading[cable] = value

    return fault


def swapped(reading, cable):
    reading[[cable, cable - 1]] = reading[[cable - 1, cable]]


def dead(reading, _):
    reading[:] = 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cdsm", "cdsm_lab"])
@pytest.mark.parametrize(
    "fault",
    [scaled(1.1), swapped, reads(2.0), dead],
    ids=["scale 1.1", "exchanged", "2 N", "all zero"],
)
def test_one_faulty_channel_of_an_untouched_arm_gives_no_force(name, fault):
    arm = Arm(name, BENT)
    for cable in range(12):
        reading = arm.reading()
        before = reading.copy()
        fault(reading, cable)
        if np.abs(reading - before).max() < 1.5:
            continue  # two cables that carry the same
        answer = arm.sample(reading)
        assert answer.contact == NO_CONTACT
        assert answer.problem is not None
        assert answer.problem.kind is ProblemKind.MISFIT
        assert not answer.probabilities
    status = arm.estimation.plausibility.status()
    assert status.level is Level.ERROR


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cdsm", "cdsm_lab"])
def test_contacts_pass_slack_cables_or_not(name):
    arm = Arm(name, BENT)
    for segment in range(1, 5):
        for angle_deg in (20.0, 110.0, 200.0, 290.0):
            for magnitude_n in (1.0, 190.0):
                forces = push(arm.arm, BENT, segment, angle_deg, magnitude_n)
                answer = arm.sample(arm.reading(forces))
                assert answer.problem is None
    assert arm.estimation.check.slack
    assert arm.estimation.plausibility.status().values["withheld"] == "0"


CHANGES_AT_ONCE = {
    "a fourth goes slack":
        ("cdsm", [-7.499, -2.551, -3.114, -6.033, -7.793, -7.305, 3.841, -0.087], 3,
         [(y, 11.72) for y in (117.0, 117.1, 117.2, 117.3)]),
    "two positions of rest":
        ("cdsm_lab", [-8.9, -4.2, 7.3, 3.2, -2.6, 6.6, 8.9, -3.1], 4,
         [(-71.0, 47.3), (-71.1, 47.4), (-70.9, 47.2)]),
    "one barely taut":
        ("cdsm", [8.01, -0.51, -6.39, 8.66, 0.55, 1.35, 3.33, 6.62], 3, 8 * [(-168.596, -82.5)]),
    "one barely taut of few":
        ("cdsm", [-6.831, 3.741, -3.204, 2.715, 5.92, 0.697, 9.038, 7.436], 3,
         8 * [(-114.8797, 76.4708)]),
}  # fmt: skip


@pytest.mark.parametrize("case", CHANGES_AT_ONCE.values(), ids=CHANGES_AT_ONCE)
def test_contacts_pass_where_rest_changes_at_once(case):
    name, command_deg, segment, forces_n = case
    command = np.deg2rad(command_deg)
    arm = Arm(name, command)
    for y, z in forces_n:
        forces = push(arm.arm, command, segment, np.rad2deg(np.arctan2(y, z)), np.hypot(y, z))
        for _ in range(5):
            assert arm.sample(arm.reading(forces)).contact.segment == segment


@pytest.mark.slow
def test_a_broken_cable_makes_no_wrong_force():
    checked, unchecked = (Arm("cdsm_lab", BENT, largest_misfit=limit) for limit in (2.3, 0.0))
    wrong_n = {checked: [], unchecked: []}
    sound = mechanism_of(checked.arm)
    for cable in range(12):
        loose = sound.pretension_n.copy()
        loose[cable] = -1e5  # it would have to stretch by centimetres to be taut
        broken = replace(sound, pretension_n=loose)
        for segment, angle_deg in ((1, 0.0), (2, 80.0), (4, 310.0)):
            for magnitude_n in (0.0, 40.0):
                forces = push(checked.arm, BENT, segment, angle_deg, magnitude_n)
                try:
                    true = solve_equilibrium(broken, BENT, forces).tensions_n
                except EquilibriumError:
                    continue  # the arm collapses
                reading = read_tensions_n(true, checked.arm.sensors, checked.rng).clip(0.0)
                for arm, off in wrong_n.items():
                    arm.now_ns += 10**9  # what was withheld before is over
                    answer = arm.sample(reading)
                    if answer.problem is None:
                        off.append(off_n(answer.contact, segment, angle_deg, magnitude_n))
    assert max(wrong_n[checked]) < 5.0 < max(wrong_n[unchecked])


def test_the_cable_whose_reading_does_not_fit_is_named():
    arm = Arm()
    reading = arm.reading()
    reading[6] *= 1.1
    problem = str(arm.sample(reading).problem)
    assert "all but the reading of cable_7 would fit" in problem
    reading = arm.reading()
    reading[3:6] *= 1.2
    arm.now_ns += 10**9
    problem = str(arm.sample(reading).problem)
    assert "all but the reading of cable_4, cable_5, cable_6 would fit" in problem
    arm.now_ns += 10**9
    reading = arm.reading()
    reading[[0, 5]] = reading[[5, 0]]
    assert "the cables of no one segment explain it" in str(arm.sample(reading).problem)
    arm.now_ns += 10**9
    reading = arm.reading(push(arm.arm, STRAIGHT, 3, 40.0, 30.0))
    reading[2] += 8.0
    arm.sample(reading)
    status = arm.estimation.plausibility.status()
    assert "all but the reading of cable_3 would fit" in status.message
    assert float(status.values["no force since stamp (s)"]) == pytest.approx(arm.now_ns * 1e-9)


@pytest.mark.slow
def test_what_passes_and_is_wrong_is_reported_as_unconfirmed():
    """With one cable of segment 1 slack, the other two carry the two components of a force."""
    arm, hidden = Arm(), 0
    for angle_deg in (0.0, 150.0, 230.0):
        forces = push(arm.arm, STRAIGHT, 1, angle_deg, 170.0)
        for cable in range(12):
            for scale in (0.0, 0.5, 0.9, 1.1):
                reading = arm.reading(forces)
                reading[cable] *= scale
                arm.now_ns += 10**9
                answer = arm.sample(reading)
                status = arm.estimation.plausibility.status()
                if answer.problem is None and off_n(answer.contact, 1, angle_deg, 170.0) > 5.0:
                    hidden += 1
                    assert answer.force is ForceState.UNCONFIRMED
                    assert status.level is Level.WARN
                    assert "no others confirm" in status.message
    assert hidden


def exchanged(arm, forces):
    reading = arm.reading(forces)
    reading[[0, 1]] = reading[[1, 0]]
    return reading


def test_averages_show_what_single_readings_of_a_fault_hide():
    arm = Arm(command=np.deg2rad([0.6, *[0.0] * 7]))
    forces = push(arm.arm, arm.command, 1, 90.0, 30.0)
    states = [arm.sample(exchanged(arm, forces)).force for _ in range(60)]
    assert states[0] is ForceState.CONTACT
    assert states[-1] is ForceState.UNCONFIRMED
    assert "on their average of" in arm.estimation.plausibility.status().message
    assert arm.sample().force is ForceState.FREE
    assert arm.sample(arm.reading(push(arm.arm, arm.command, 3, 0.0, 30.0))).force.known


def test_averages_of_healthy_contacts_fit():
    arm = Arm("cdsm_lab", command=BENT)
    for segment, angle_deg, size_n in ((1, 0.0, 40.0), (2, 100.0, 120.0), (4, 250.0, 180.0)):
        forces = push(arm.arm, BENT, segment, angle_deg, size_n)
        states = {arm.sample(arm.reading(forces)).force for _ in range(60)}
        assert states == {ForceState.CONTACT}


@pytest.mark.parametrize(
    ("faulty_s", "most_s"), [(0.01, LEAST_WITHHELD_S), (0.12, 0.12), (1.0, WITHHELD_S)]
)
def test_forces_return_once_readings_have_fitted_as_long_as_they_did_not(faulty_s, most_s):
    arm = Arm()
    forces = push(arm.arm, STRAIGHT, 2, 0.0, 40.0)
    assert arm.sample(arm.reading(forces)).contact.segment == 2
    faulty = arm.reading(forces)
    faulty[0] += 30.0
    period_s = PERIOD_NS * 1e-9
    for _ in range(round(faulty_s / period_s)):
        assert arm.misfits(faulty)
    withheld = 0
    while arm.misfits(arm.reading(forces)):
        withheld += 1
    assert 0.5 * most_s - period_s <= withheld * period_s <= most_s
    assert arm.sample(arm.reading(forces)).contact.segment == 2


@pytest.mark.parametrize("fault", [scaled(1.3), reads(0.0), swapped])
def test_a_fault_makes_no_wrong_forces_on_several_segments_that_are_vouched_for(fault):
    arm, told = Arm(model="cdsm_multi"), {1: (75.0, 25.0), 3: (300.0, 30.0)}
    forces = sum(push(arm.arm, STRAIGHT, segment, *load) for segment, load in told.items())
    for _ in range(20):
        answer = arm.sample(arm.reading(forces))
        assert answer.problem is None
        assert most_off_n(answer, told) < 3.0
    withheld = 0
    for cable in range(12):
        reading = arm.reading(forces)
        fault(reading, cable)
        arm.now_ns += 10**9  # what came before withholds no longer
        answer = arm.sample(reading)
        withheld += answer.problem is not None
        assert answer.force is not ForceState.CONTACT or most_off_n(answer, told) < 5.0
    assert withheld >= 6


@pytest.mark.parametrize(
    ("changes", "why"),
    [({"largest_misfit": 0.0}, "switched off"), ({"model": "cdsm_moving"}, "history-dependent")],
)
def test_what_is_not_checked_is_reported_as_such(changes, why):
    arm = Arm(**changes)
    reading = arm.reading()
    reading[3] *= 2.0
    assert arm.sample(reading).problem is None
    assert why in arm.estimation.plausibility.status().message


OTHER = MisfitLimit(largest_misfit=3.5, false_alarm_rate=0.25, samples=40, above=10)


def copied(tmp_path, name="cdsm"):
    path = tmp_path / f"{name}.onnx"
    path.write_bytes(config_path(f"models/{name}.onnx").read_bytes())
    return path


def test_a_limit_changes_nothing_else_of_a_file_and_a_parameter_overrides_it(tmp_path):
    path = copied(tmp_path)
    origin = LoadedModel.open(path).origin
    replace_misfit_limit(path, None)
    without = path.read_bytes()
    replace_misfit_limit(path, OTHER)
    assert path.read_bytes().startswith(without)
    assert LoadedModel.open(path).origin == origin
    assert LoadedModel.open(path).largest_misfit(-1.0) == 3.5
    assert LoadedModel.open(path).largest_misfit(3.0) == 3.0
    assert LoadedModel.open(path).largest_misfit(0.0) == 0.0
    replace_misfit_limit(path, None)
    assert path.read_bytes() == without
    assert LoadedModel.open(path).largest_misfit(-1.0) == 2.3


def test_a_file_may_not_state_a_limit_that_checks_nothing(tmp_path):
    path = copied(tmp_path)
    replace_misfit_limit(path, OTHER.model_copy(update={"largest_misfit": 7.5}))
    with pytest.raises(ModelFileError, match=r"of 7\.5; noise of 12 readings allows 4\.57 "):
        LoadedModel.open(path).largest_misfit(-1.0)
    assert LoadedModel.open(path).largest_misfit(3.0) == 3.0


@pytest.mark.parametrize(
    ("stated", "largest", "origin"),
    [
        (OTHER, -1.0, "of the model file: above it are 10 of 40 simulated healthy samples"),
        (OTHER, 3.0, "of the parameter largest_misfit"),
        (None, -1.0, "by default: the model file states none"),
    ],
)
def test_diagnostics_state_where_the_limit_comes_from(tmp_path, stated, largest, origin):
    path = copied(tmp_path)
    replace_misfit_limit(path, stated)
    largest = LoadedModel.open(path).largest_misfit(largest)
    arm = Arm(model=str(path), largest_misfit=largest)
    values = arm.estimation.plausibility.status().values
    assert values["largest misfit that passes"] == f"{largest:g}"
    assert values["this limit is"].startswith(origin)


@pytest.mark.slow
def test_fresh_healthy_samples_are_as_rarely_above_the_limit_as_it_states(tmp_path, monkeypatch):
    monkeypatch.setattr(misfit_limit, "POSES", 2)
    limit = put_simulated_limit(copied(tmp_path, "cdsm_lab"))
    fresh = np.fromiter(simulated_misfits(loaded_model("cdsm_lab", ""), 1, 1), float)
    spare = 3.0 * np.sqrt(max(limit.above, 1) * misfit_limit.READINGS)  # of a contact all are
    assert (fresh > limit.largest_misfit).sum() <= limit.above + spare
    assert np.median(fresh) == pytest.approx(1.0, abs=0.2)
