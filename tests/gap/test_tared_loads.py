"""Loads against their tare: the unloaded rows just before, at the same command."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import CYCLE, small_recording

from cablesense_gap.retraining import AT_PEAK, tared_loads

COURSE = small_recording()


def test_the_tare_is_the_mean_of_the_unloaded_rows_just_before():
    rng = np.random.default_rng(0)
    readings = rng.normal(50.0, 1.0, COURSE.tensions_n.shape)
    loads = tared_loads(replace(COURSE, tensions_n=readings))
    second = np.flatnonzero(loads.trial == 2)[0]
    # four rows at the end of the cycle before it and four at its own beginning
    first = loads.row[second]
    tare = readings[first - 8 : first].mean(0)
    assert loads.tension_difference_n[second] == pytest.approx(readings[first] - tare)


def test_every_loaded_row_of_the_course_has_a_tare():
    loads = tared_loads(COURSE)
    assert np.array_equal(loads.row, np.flatnonzero(COURSE.load_segment))
    assert np.array_equal(loads.force_n, COURSE.load_n[loads.row])
    assert np.array_equal(loads.segment, COURSE.load_segment[loads.row])


def test_the_peak_is_of_each_trial():
    loads = tared_loads(COURSE)
    expected = int((CYCLE >= AT_PEAK).sum())
    assert [int(loads.at_peak[loads.trial == t].sum()) for t in range(1, 9)] == [expected] * 8


def test_a_load_under_another_command_than_its_tare_is_left_out():
    command = COURSE.command_rad.copy()
    loaded = np.flatnonzero(COURSE.load_segment)[0]
    command[loaded:] += 0.01
    loads = tared_loads(replace(COURSE, command_rad=command))
    assert loaded not in loads.row
    assert len(loads) < len(tared_loads(COURSE))


def test_no_rest_no_tare():
    everywhere = np.ones_like(COURSE.load_segment)
    assert len(tared_loads(replace(COURSE, load_segment=everywhere))) == 0
