"""Recordings in their own time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.can.emulator import PAUSE_S, RecordingPlayer

TIME_S = np.array([5.0, 5.1, 5.2])
TENSIONS_N = np.arange(6.0).reshape(3, 2)
COMMANDS_RAD = np.array([[0.0], [0.0], [0.1]])


def make(loop=False):
    return RecordingPlayer(TIME_S, TENSIONS_N, COMMANDS_RAD, loop)


def tensions(rows):
    return [row[0].tolist() for row in rows]


def test_rows_come_when_they_are_due_and_a_command_when_it_is_new():
    player = make()
    first = player.due(100.0)
    assert tensions(first) == [[0.0, 1.0]]
    assert first[0][1].tolist() == [0.0]
    rest = player.due(100.25)
    assert tensions(rest) == [[2.0, 3.0], [4.0, 5.0]]
    assert rest[0][1] is None
    assert rest[1][1].tolist() == [0.1]
    assert player.ended
    assert player.due(200.0) == []


def test_an_unchanged_command_is_told_again_once_a_second():
    time_s = np.arange(31) * 0.1
    player = RecordingPlayer(time_s, np.zeros((31, 2)), np.zeros((31, 1)), loop=False)
    rows = [row for step in range(31) for row in player.due(50.0 + step * 0.1 + 1e-6)]
    told = [number for number, (_, command) in enumerate(rows) if command is not None]
    assert len(rows) == 31
    assert told == pytest.approx([0, 10, 20, 30], abs=2)


def test_a_loop_begins_again_after_a_pause():
    player = make(loop=True)
    player.due(100.0)
    player.due(100.25)
    assert player.due(100.2 + PAUSE_S - 0.01) == []
    again = player.due(100.2 + PAUSE_S + 0.01)
    assert tensions(again) == [[0.0, 1.0]]
    assert again[0][1].tolist() == [0.0]
    assert not player.ended


@given(st.lists(st.floats(0.0, 0.2), max_size=40))
def test_every_row_comes_once_and_in_order(waits_s):
    player, now_s, found = make(), 7.0, []
    found += tensions(player.due(now_s))
    for wait_s in waits_s:
        now_s += wait_s
        found += tensions(player.due(now_s))
    assert found == TENSIONS_N.tolist()[: len(found)]
    assert player.ended == (len(found) == 3)
