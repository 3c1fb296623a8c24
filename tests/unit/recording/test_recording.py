"""Trials of a recording that names none, and rows as people count them."""

from __future__ import annotations

import numpy as np
import pytest

from cablesense_recording.recording import derive_trials


def trials(loads=(), commands=None, time_s=None, rows=60):
    """At 5 Hz; `loads` as (first row, last row, segment, force)."""
    segment = np.zeros(rows, dtype=np.int64)
    force = np.zeros((rows, 3))
    for first, last, number, push in loads:
        segment[first:last] = number
        force[first:last] = push
    command = np.zeros((rows, 8)) if commands is None else commands
    time_s = 0.2 * np.arange(rows) if time_s is None else time_s
    return derive_trials(time_s, command, segment, force)


def begins(found):
    return np.flatnonzero(np.diff(found) > 0).tolist()


def test_a_load_begins_a_trial_and_what_follows_it_belongs_to_it():
    assert begins(trials([(20, 30, 2, (0, 0, -9))])) == [19]


@pytest.mark.parametrize(
    ("second", "parts"),
    [
        ((24, 30, 2, (0, 0, -5)), False),  # a step of the same load
        ((30, 35, 2, (0, 1, -9)), False),  # off and on again, from nearly the same side
        ((24, 30, 2, (0, 9, -9)), True),  # from another side
        ((24, 30, 3, (0, 0, -9)), True),  # on another segment
        ((45, 50, 2, (0, 0, -9)), True),  # after a rest
    ],
)
def test_what_parts_two_loads(second, parts):
    assert (second[0] - 1 in begins(trials([(20, 24, 2, (0, 0, -9)), second]))) == parts


def test_a_sweep_begins_where_the_command_starts_to_move_and_does_not_fall_apart():
    commands = np.zeros((60, 8))
    commands[20:40, 3] = 0.01 * np.arange(1, 21)
    commands[40:, 3] = 0.2
    assert begins(trials(commands=commands)) == [19]


def test_a_gap_parts():
    time_s = 0.2 * np.arange(60)
    time_s[33:] += 5.0
    assert begins(trials(time_s=time_s)) == [32]
