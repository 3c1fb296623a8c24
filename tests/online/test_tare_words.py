"""Tares in words: values, deviations and times, in the log and in diagnostics."""

import numpy as np
import pytest

from cablesense_msgs_py.diagnostics import Level
from cablesense_online.tare import (
    TareModel,
    tare_status,
    tare_taken_line,
    tare_undone_line,
    time_text,
)

CABLES = ("cable_1", "cable_2")
EARLY_NS = 1_700_000_000_000_000_000
LATE_NS = EARLY_NS + 3_600_000_000_000


@pytest.fixture
def tares():
    made = TareModel(lambda _: np.array([50.0, 60.0]), np.zeros(1), 1, steady_n=1.0)
    made.add((50.25, 58.5))
    return made


def test_times_are_in_utc():
    assert time_text(EARLY_NS) == "2023-11-14 22:13:20 UTC"


def test_the_log_has_every_value_and_how_far_it_is_from_the_model(tares):
    line = tare_taken_line(tares.take(EARLY_NS), CABLES, "on request")
    assert "on request at 2023-11-14 22:13:20 UTC" in line
    assert "cable_1 50.25 (+0.25), cable_2 58.50 (-1.50)" in line


def test_what_counts_again_after_an_undo_is_told(tares):
    first = tares.take(EARLY_NS)
    tares.add((70.0, 80.0))
    second = tares.take(LATE_NS)
    assert tares.undo() is first
    line = tare_undone_line(second, first, CABLES, tares.undoable)
    assert "tare of 2023-11-14 23:13:20 UTC undone" in line
    assert "at 2023-11-14 22:13:20 UTC" in line
    assert "cable_1 50.25" in line
    assert "1 left to undo" in line
    assert tares.undo() is None
    assert "no estimate" in tare_undone_line(first, None, CABLES, 0)


def test_diagnostics_say_since_when(tares):
    assert tare_status(tares).level is Level.WARN
    tares.take(EARLY_NS)
    tares.add((70.0, 80.0))
    tares.take(LATE_NS)
    status = tare_status(tares)
    assert status.level is Level.OK
    assert status.message == "tared since 2023-11-14 23:13:20 UTC"
    assert status.values["tares that can be undone"] == "2"
    assert status.values["unloaded tensions (N)"] == "70.00, 80.00"
    tares.undo()
    assert "22:13:20" in tare_status(tares).message
