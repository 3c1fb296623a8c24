"""The unloaded state: measured at one command, carried to others, taken only at rest, undone."""

import numpy as np
import pytest

from cablesense_online.tare import TareError, TareModel

NOW_NS = 1_700_000_000_000_000_000
OFFSET = np.array([0.5, -1.0, 2.0])


def predict(command_rad):
    return 50.0 + 100.0 * np.array([1.0, -0.5, 0.2]) * command_rad[0]


def model(samples=4):
    return TareModel(predict, np.zeros(1), samples, steady_n=0.5)


def feed(tare, readings_n, count=4):
    for _ in range(count):
        tare.add(readings_n)


def test_a_tare_is_the_average_of_the_last_readings():
    tare = model()
    for shift in (9.0, -0.1, 0.1, -0.3, 0.3):
        tare.add(predict([0.0]) + OFFSET + shift)
    taken = tare.take(NOW_NS)
    np.testing.assert_allclose(tare.unloaded_n, predict([0.0]) + OFFSET)
    assert taken.offset_n == pytest.approx(2.0)


def test_offsets_go_along_to_another_command():
    tare = model()
    feed(tare, predict([0.0]) + OFFSET)
    tare.take(NOW_NS)
    tare.command(np.array([0.1]))
    np.testing.assert_allclose(tare.unloaded_n, predict([0.1]) + OFFSET)
    tare.command(np.array([0.0]))
    np.testing.assert_allclose(tare.unloaded_n, predict([0.0]) + OFFSET)


def test_undo_goes_back_step_by_step_also_at_another_command():
    tare = model()
    feed(tare, predict([0.0]) + OFFSET)
    tare.take(NOW_NS)
    feed(tare, predict([0.0]) + 3 * OFFSET)
    tare.take(NOW_NS)
    tare.command(np.array([0.1]))
    assert tare.undoable == 2
    assert tare.undo() is tare.present
    assert tare.undoable == 1
    np.testing.assert_allclose(tare.unloaded_n, predict([0.1]) + OFFSET)
    assert tare.undo() is None
    assert tare.unloaded_n is None
    with pytest.raises(TareError, match="nothing to undo"):
        tare.undo()


def test_too_few_readings_since_the_command_are_refused():
    tare = model()
    feed(tare, predict([0.0]), 3)
    with pytest.raises(TareError, match="only 3 of 4"):
        tare.take(NOW_NS)
    feed(tare, predict([0.0]))
    tare.command(np.array([0.1]))
    assert not tare.ready
    with pytest.raises(TareError, match="only 0 of 4"):
        tare.take(NOW_NS)


def test_a_moving_arm_is_refused_by_cable():
    tare = model()
    for push in (0.0, 2.0, 4.0, 6.0):
        tare.add(predict([0.0]) + np.array([0.0, push, 0.0]))
    assert not tare.ready
    with pytest.raises(TareError, match=r"cable_2 varies by 2\.24 N"):
        tare.take(NOW_NS)
    assert tare.present is None
