"""The unloaded state: measured at one command, carried to others, taken only at rest, undone."""

import numpy as np
import pytest
from arm_variants import variant

from cablesense_msgs_py.messages import Level
from cablesense_online.tare import (
    TareError,
    Tares,
    UnloadedTensions,
    tare_undone_line,
)
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium

NOW_NS = 1_700_000_000_000_000_000
ZERO = np.zeros(1)
OFFSET = np.array([0.5, -1.0, 2.0])


def predict(command_rad):
    return 50.0 + 100.0 * np.array([1.0, -0.5, 0.2]) * command_rad[0]


def model(samples=4):
    return Tares(predict, np.zeros(1), samples, steady_n=0.5)


def feed(tare, readings_n, count=4):
    for _ in range(count):
        tare.add(readings_n)


def test_a_tare_is_the_average_of_the_last_readings():
    tare = model()
    for shift in (9.0, -0.1, 0.1, -0.3, 0.3):
        tare.add(predict([0.0]) + OFFSET + shift)
    taken = tare.take(ZERO, NOW_NS)
    np.testing.assert_allclose(tare.unloaded_n, predict([0.0]) + OFFSET)
    assert taken.offset_n == pytest.approx(2.0)


def test_undo_goes_back_step_by_step_also_at_another_command():
    tare = model()
    feed(tare, predict([0.0]) + OFFSET)
    tare.take(ZERO, NOW_NS)
    feed(tare, predict([0.0]) + 3 * OFFSET)
    tare.take(ZERO, NOW_NS)
    tare.command(np.array([0.1]))
    assert tare.undoable == 2
    assert tare.undo() is tare.present
    assert tare.undoable == 1
    np.testing.assert_allclose(tare.unloaded_n, predict([0.1]) + OFFSET)
    assert tare.undo() is None
    assert tare.unloaded_n is None
    with pytest.raises(TareError, match="nothing to undo"):
        tare.undo()


def test_too_few_or_unsteady_readings_are_refused():
    tare = model()
    feed(tare, predict([0.0]), 3)
    tare.command(np.array([0.1]))
    assert not tare.ready
    with pytest.raises(TareError, match="only 0 of 4"):
        tare.take(ZERO, NOW_NS)
    for push in (0.0, 2.0, 4.0, 6.0):
        tare.add(predict([0.1]) + np.array([0.0, push, 0.0]))
    with pytest.raises(TareError, match=r"cable_2 varies by 2\.24 N"):
        tare.take(ZERO, NOW_NS)
    assert tare.present is None


def judging(automatic=False, complete=True):
    return Tares(
        predict, np.zeros(1), 4, 0.5, deviation_n=1.5, complete=complete, automatic=automatic
    )


def test_readings_far_from_the_model_are_refused_with_the_figure_unless_forced():
    tares = judging()
    feed(tares, predict([0.0]) + OFFSET)
    with pytest.raises(TareError, match=r"cable_3 lies \+2\.0 N .*at most 1\.5 N.*tare_force"):
        tares.take(ZERO, NOW_NS)
    assert tares.present is None
    tares.take(ZERO, NOW_NS, forced=True)
    status = tares.status()
    assert (status.level, "2.0 N from the arm file" in status.message) == (Level.WARN, True)


def test_an_automatic_tare_waits_and_gives_the_figure():
    tares = judging(automatic=True)
    feed(tares, predict([0.0]) + OFFSET, 3)
    assert tares.awaited == ""
    feed(tares, predict([0.0]) + OFFSET)
    assert "cable_3 lies +2.0 N" in tares.awaited
    assert "auto_tare waits: cable_3 lies +2.0 N" in tares.status().message
    feed(tares, predict([0.0]))
    assert tares.ready
    tares.take(ZERO, NOW_NS, by_itself=True)
    assert not tares.automatic


def test_an_arm_whose_file_lists_more_than_the_model_has_is_not_judged_by_it():
    tares = judging(complete=False)
    feed(tares, predict([0.0]) + OFFSET)
    assert tares.take(ZERO, NOW_NS).offset_n == pytest.approx(2.0)
    assert tares.status().level is Level.OK
    friction = {"effect": "capstan_friction", "at": "arm", "parameters": {"coefficient": 0.1}}
    zero = {"effect": "cable_tolerance", "at": "cable_1", "parameters": {"zero_n": 0.3}}
    assert not UnloadedTensions(variant({"effects": [zero]})).incomplete
    assert UnloadedTensions(variant({"effects": [zero, friction]})).incomplete


@pytest.mark.parametrize(
    ("by_itself", "first", "angle_rad", "dropped"),
    [
        (True, True, 0.1, True),
        (True, True, 0.001, False),
        (True, False, 0.1, False),
        (False, True, 0.1, False),
    ],
)
def test_a_first_command_elsewhere_drops_the_automatic_tare(by_itself, first, angle_rad, dropped):
    tares = judging()
    feed(tares, predict([0.0]))
    tare = tares.take(ZERO, NOW_NS, by_itself=by_itself)
    assert tares.command(np.array([angle_rad]), first=first) is dropped
    assert (tares.present is None) is dropped
    assert tares.automatic is dropped
    assert dropped or tares.present is tare


def test_a_dropped_tare_is_not_come_back_to():
    tares = judging()
    feed(tares, predict([0.0]))
    tares.take(ZERO, NOW_NS, by_itself=True)
    requested = tares.take(ZERO, NOW_NS)
    assert not tares.command(np.array([0.1]), first=True)
    assert tares.present is requested
    assert tares.undo() is None


CABLES = ("cable_1", "cable_2")
EARLY_NS = 1_700_000_000_000_000_000
LATE_NS = EARLY_NS + 3_600_000_000_000


@pytest.fixture
def tares():
    made = Tares(lambda _: np.array([50.0, 60.0]), np.zeros(1), 1, steady_n=1.0)
    made.add((50.25, 58.5))
    return made


def test_log_and_diagnostics_have_times_and_values_of_the_tare_in_force(tares):
    first = tares.take(ZERO, EARLY_NS)
    line = first.described(CABLES)
    assert "at 2023-11-14 22:13:20 UTC" in line
    assert "cable_1 50.25 (+0.25), cable_2 58.50 (-1.50)" in line
    tares.add((70.0, 80.0))
    second = tares.take(ZERO, LATE_NS)
    status = tares.status()
    assert status.message == "tared since 2023-11-14 23:13:20 UTC"
    assert status.values["tares that can be undone"] == "2"
    assert status.values["unloaded tensions (N)"] == "70.00, 80.00"
    assert tares.undo() is first
    line = tare_undone_line(second, first, CABLES, tares.undoable)
    assert "tare of 2023-11-14 23:13:20 UTC undone" in line
    assert "at 2023-11-14 22:13:20 UTC" in line
    assert "cable_1 50.25" in line
    assert "1 left to undo" in line
    assert tares.undo() is None
    assert "no estimate" in tare_undone_line(first, None, CABLES, 0)


ARM = open_arm("cdsm")
BENT = np.deg2rad([8.0, -5.0, 3.0, 0.0, -9.0, 4.0, 2.0, 7.0])


def test_a_payload_pulls_like_its_weight():
    payload = {"effect": "payload", "at": "segment_2", "parameters": {"mass_kg": 0.4}}
    force = np.zeros((4, 3))
    force[1, 2] = -0.4 * 9.81
    expected = solve_equilibrium(mechanism_of(ARM), BENT, force).tensions_n
    assert np.abs(expected - UnloadedTensions(ARM).predict_n(BENT)).max() > 1.0
    found = UnloadedTensions(variant({"effects": [payload]})).predict_n(BENT)
    np.testing.assert_allclose(found, expected, atol=0.05)


def test_actuators_hold_the_lengths_of_the_arm_as_it_was_drawn():
    """Holes further out ask for another length at a bent pose, which no actuator knows of."""
    parameters = {"cables_radius_m": 1e-4}
    holes = {"effect": "routing_geometry", "at": "segment_2", "parameters": parameters}
    unloaded = UnloadedTensions(variant({"effects": [holes]}))
    as_known = solve_equilibrium(unloaded.mechanism, BENT).tensions_n
    change = unloaded.predict_n(BENT) - as_known
    # joints bent by some 0.1 rad, times 0.1 mm, on stiff cables
    assert np.abs(change[3:6]).max() > 1.0
    np.testing.assert_allclose(
        unloaded.predict_n(np.zeros(8)),
        solve_equilibrium(unloaded.mechanism, np.zeros(8)).tensions_n,
        atol=1e-6,
    )
