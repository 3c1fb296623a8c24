"""Pulls by hand: right, exchanged, dead, unclear, too weak, and tables that cannot be."""

import numpy as np
import pytest
from sensor_series import ARM, EXPECTED, RATE_HZ, good_tensions_n, series

from cablesense_base.errors import CableSenseError
from cablesense_online.commissioning.sensor_statistics import PullVerdict, judge_pull
from cablesense_online.commissioning.tables import Pull, TimeWindow, read_pulls

WINDOW = TimeWindow(4.0, 7.0)


def judged(moves_n, dead=None, window=WINDOW):
    """What a pull of cable_3 shows that moves channels (from 0) by so much."""
    tensions_n = good_tensions_n()
    pulled = slice(int(4.5 * RATE_HZ), int(6.5 * RATE_HZ))
    for channel, move_n in moves_n.items():
        tensions_n[pulled, channel] += move_n
    if dead is not None:
        tensions_n[:, dead] = 50.0
    return judge_pull(series(tensions_n), Pull("cable_3", window), EXPECTED.floor_n)


def test_its_own_channel_moves_most():
    found = judged({2: 20.0, 4: -9.0})
    assert found.verdict is PullVerdict.RIGHT
    assert (found.moved, found.second) == ("cable_3", "cable_5")
    assert found.moved_n == pytest.approx(20.0, abs=0.5)


@pytest.mark.parametrize(
    ("moves_n", "dead", "verdict"),
    [
        ({4: 20.0, 2: -9.0}, None, PullVerdict.SWAPPED),
        ({4: 20.0}, None, PullVerdict.SWAPPED),
        ({4: 20.0}, 2, PullVerdict.DEAD),
        ({2: 20.0, 4: -18.0}, None, PullVerdict.UNCLEAR),
        ({4: 20.0, 2: 18.0}, None, PullVerdict.UNCLEAR),
        ({2: 0.3}, None, PullVerdict.TOO_WEAK),
    ],
)
def test_what_a_pull_shows(moves_n, dead, verdict):
    assert judged(moves_n, dead).verdict is verdict


@pytest.mark.parametrize("window", [TimeWindow(0.0, 2.0), TimeWindow(50.0, 60.0)])
def test_a_pull_without_readings_around_it_is_refused(window):
    with pytest.raises(CableSenseError, match="pull of cable_3 from"):
        judged({}, window=window)


def test_pulls_are_read_from_a_table(tmp_path):
    path = tmp_path / "pulls.csv"
    path.write_text("cable,start_s,end_s\ncable_2,4,7\n", encoding="utf-8")
    assert read_pulls(path, ARM.cable_names) == [Pull("cable_2", WINDOW)]
    path.write_text("cable,start_s,end_s\ncable_22,4,7\n", encoding="utf-8")
    with pytest.raises(CableSenseError, match=r"pulls\.csv: line 2: no cable 'cable_22'"):
        read_pulls(path, ARM.cable_names)


def test_a_swap_is_seen_from_both_ends():
    tensions_n = good_tensions_n(20.0)
    for start_s, cable in ((4.5, 2), (12.5, 7)):
        rows = slice(int(start_s * RATE_HZ), int((start_s + 2.0) * RATE_HZ))
        tensions_n[rows, cable] += 20.0
    tensions_n[:, [2, 7]] = tensions_n[:, [7, 2]]
    found = [
        judge_pull(series(tensions_n), Pull(cable, window), EXPECTED.floor_n)
        for cable, window in (("cable_3", WINDOW), ("cable_8", TimeWindow(12.0, 15.0)))
    ]
    assert [result.moved for result in found] == ["cable_8", "cable_3"]
    assert {result.verdict for result in found} == {PullVerdict.SWAPPED}
    assert np.isfinite(found[0].own_n)
