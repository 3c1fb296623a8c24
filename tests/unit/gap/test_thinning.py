"""Rows of a long recording: few, of every trial, with all turns of command and load."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_recording import recording as recordings
from cablesense_recording.recording import Recording, returns, rows_along_path, rows_to_use


def recording(command, load_z_n, trial=None) -> Recording:
    """At 1 kHz; one joint moves, and one segment is loaded along z."""
    rows = len(command)
    load_n = np.outer(load_z_n, [0.0, 0.0, 1.0])
    return Recording(
        name="long",
        time_s=1e-3 * np.arange(rows),
        trial=np.zeros(rows, dtype=np.int64) if trial is None else trial,
        command_rad=np.outer(command, np.eye(8)[2]),
        load_segment=np.where(load_n.any(axis=1), 2, 0),
        load_n=load_n,
        tensions_n=np.zeros((rows, 12)),
    )


def test_a_load_that_goes_to_another_place_is_kept_on_both_sides():
    """Of a load that is pushed along the segment at the same force, only the place changes."""
    made = recording(np.zeros(20_000), np.full(20_000, 9.0))
    at_m = np.where(np.arange(20_000) < 12_345, 0.03, 0.11)
    kept = rows_to_use(replace(made, load_at_m=at_m))
    assert {12_344, 12_345} <= set(kept)
    assert {12_344, 12_345} <= set(rows_along_path(replace(made, load_at_m=at_m)))


@pytest.mark.slow
@given(
    st.lists(st.tuples(st.integers(0, 40), st.integers(1, 200)), min_size=1, max_size=60),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 1e-3, 1.0]),
)
@settings(max_examples=60)
def test_there_are_never_too_many_and_of_each_trial_the_ends(blocks, seed, noise):
    trial = np.repeat([number for number, _ in blocks], [rows for _, rows in blocks])
    rng = np.random.default_rng(seed)
    held = np.repeat(rng.normal(size=len(blocks)), [rows for _, rows in blocks])
    load_n = 9.0 * rng.integers(0, 2, len(trial)) * rng.normal(size=len(trial))
    made = recording(held + noise * rng.normal(size=len(trial)), load_n, trial)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recordings, "MOST_READINGS", 3600)
        patch.setattr(recordings, "MOST_TRIALS", 30)
        rows = rows_to_use(made)
    assert (np.diff(rows) > 0).all()
    assert len(rows) <= 300 or len(rows) == len(trial)
    used = made.rows(rows)
    present = np.unique(trial)
    kept = np.unique(used.trial)
    assert len(kept) == min(len(present), 30)
    for number in kept:
        ends = np.flatnonzero(trial == number)[[0, -1]]
        assert np.isin(ends, rows).all()


def test_turns_of_a_sweep_are_kept_to_the_row():
    turns = np.array([0, 7_123, 23_456, 31_001, 44_444, 59_999])
    command = np.interp(np.arange(60_000), turns, [0.0, 0.1, -0.15, 0.02, -0.01, 0.0])
    rows = rows_to_use(recording(command, np.zeros(60_000)))
    assert np.isin(turns, rows).all()
    assert len(rows) <= recordings.ENOUGH_ROWS
    assert np.diff(rows).max() <= 60_000 / (0.9 * recordings.ENOUGH_ROWS)


def test_a_high_rate_adds_no_rows_beyond_what_the_diagnosis_needs():
    """Six and a half minutes at 50 Hz, as many at 5 Hz, and half an hour at 5 Hz."""
    for rows, period_s, most in ((20_000, 0.02, 2_000), (2_000, 0.2, 2_000), (9_000, 0.2, 6_000)):
        command = 0.1 * np.sin(np.linspace(0.0, 60.0, rows))
        made = replace(
            recording(command, np.zeros(rows)), time_s=period_s * np.arange(rows, dtype=float)
        )
        used = rows_to_use(made)
        assert 0.95 * most <= len(used) <= most


@pytest.mark.parametrize("hysteresis_n", [0.0, 0.02, 2.0])
def test_what_the_past_does_shows_where_loads_return(hysteresis_n):
    loads_n = np.repeat([0.0, 5.0, 10.0, 20.0, 10.0, 5.0] * 20, 4)
    falling = np.repeat([0.0, 0.0, 0.0, 0.0, 1.0, 1.0] * 20, 4)
    made = recording(np.zeros(len(loads_n)), loads_n)
    noise_n = np.random.default_rng(5).normal(0.0, 0.05, made.tensions_n.shape)
    read_n = 30.0 + np.outer(loads_n + hysteresis_n * falling, np.ones(12)) + noise_n
    found_n, rows = returns(replace(made, tensions_n=read_n), 0.05)
    assert set(loads_n[rows]) == {5.0, 10.0}
    assert found_n == pytest.approx(0.5 * hysteresis_n, abs=0.02)
    assert found_n >= 0.5 * hysteresis_n


def test_one_way_through_all_states_shows_nothing_of_the_past():
    up = np.repeat(np.arange(10.0), 20)
    assert returns(recording(np.zeros(200), up), 0.05) is None
    assert returns(recording(np.zeros(800), np.tile(up, 4)), 0.05) is None
