"""Stays of a recording that a touch interrupts: what is read before and after it."""

import numpy as np
import pytest

from cablesense_contact.calibration import Unloaded
from cablesense_contact.unloaded_holds import SETTLING_S, unloaded_holds
from cablesense_recording.recording import Recording, RecordingError

RATE_HZ = 2.0
UNSETTLED = round(SETTLING_S * RATE_HZ)
"""Rows after a move or a touch that are left out."""
HERE = 0.1
"""The command, rad, of the stay that is looked at; it comes from 0."""


def holds_of(stretches: list[int], touched: int = 2) -> list[Unloaded]:
    """Those at a command at which untouched stretches of some rows part touches of others.

    A stay at another command comes before. Each row reads its number.
    """
    loads = [0] * (UNSETTLED + 4)
    commands = [0.0] * len(loads)
    for number, rows in enumerate(stretches):
        if number:
            loads += [1] * touched
        loads += [0] * rows
    commands += [HERE] * (len(loads) - len(commands))
    count = len(loads)
    recording = Recording(
        name="made",
        time_s=np.arange(count) / RATE_HZ,
        trial=np.zeros(count, dtype=np.int64),
        command_rad=np.array(commands)[:, None],
        load_segment=np.array(loads),
        load_n=np.array(loads, dtype=float)[:, None] * np.array([0.0, 0.0, 1.0]),
        tensions_n=np.arange(count, dtype=float)[:, None],
    )
    return [hold for hold in unloaded_holds(recording) if hold.command_rad[0] == HERE]


def test_two_long_stretches_are_two_holds_and_slides_are_unknown_after_the_touch() -> None:
    before, after = holds_of([UNSETTLED + 3, UNSETTLED + 4])
    assert (before.count, after.count) == (3, 4)
    np.testing.assert_array_equal(before.came_from_rad, [0.0])
    assert after.came_from_rad is None


def test_short_stretches_make_one_hold_together_with_unknown_slides() -> None:
    begin = UNSETTLED + 4
    (together,) = holds_of([UNSETTLED + 1, UNSETTLED + 2])
    rows = begin + np.array([UNSETTLED, 2 * UNSETTLED + 3, 2 * UNSETTLED + 4])
    assert together.count == len(rows)
    assert together.reading_n[0] == pytest.approx(rows.mean())
    assert together.came_from_rad is None


def test_a_short_stretch_beside_a_long_one_does_not_spoil_its_known_slides() -> None:
    (alone,) = holds_of([UNSETTLED + 5, UNSETTLED + 2])
    assert alone.count == 5
    np.testing.assert_array_equal(alone.came_from_rad, [0.0])


def test_what_has_not_settled_never_counts() -> None:
    assert holds_of([UNSETTLED] * 9) == []


def test_stays_in_two_trials_are_not_taken_together() -> None:
    count = 2 * (UNSETTLED + 2)
    recording = Recording(
        name="made",
        time_s=np.arange(count + 1) / RATE_HZ,
        trial=np.repeat([0, 1, 2], [1, count // 2, count // 2]),
        command_rad=np.zeros((count + 1, 1)),
        load_segment=np.zeros(count + 1, dtype=np.int64),
        load_n=np.zeros((count + 1, 3)),
        tensions_n=np.zeros((count + 1, 1)),
    )
    with pytest.raises(RecordingError, match="never rests unloaded"):
        unloaded_holds(recording)
