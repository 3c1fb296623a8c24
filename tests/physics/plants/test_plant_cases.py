"""Cases and sets of them: schedules, what is hidden, how much of it, and the answers."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cablesense_base import Array
from cablesense_plants.arm.arm import draw_history, draw_schedule, ideal_arm
from cablesense_plants.arm.blind_cases import draw_kinds, gap_n, make_case
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.listed import LISTED, ArmDraw
from cablesense_plants.arm.unlisted import UNLISTED
from tests.helpers.arm_variants import five_by_four_text
from tests.helpers.plant_arm import NOMINAL, two_segments

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("seed", range(2))
def test_a_recording_has_its_25_trials(seed: int) -> None:
    schedule = draw_schedule(NOMINAL, np.random.default_rng(seed))
    rows = np.bincount(schedule.trial)
    assert rows.tolist() == [20, *[33] * 12, 440, 25, *[33] * 4, 205, 20, *[33] * 4]
    np.testing.assert_allclose(schedule.time_s, 0.2 * np.arange(1370))
    assert np.abs(schedule.command_rad).max() < np.deg2rad(10.0)
    loads = np.linalg.norm(schedule.load_n, axis=1)
    assert loads.max() < 75.0
    np.testing.assert_array_equal(loads > 0.0, schedule.load_segment > 0)
    assert set(schedule.load_segment) == {0, 1, 2, 3, 4}
    straight = (schedule.trial >= 1) & (schedule.trial <= 12)
    assert not schedule.command_rad[straight].any()
    assert not schedule.load_n[:, 0].any()
    at_m = NOMINAL.contact_m[0]
    for segment in range(1, 5):
        places = np.unique(schedule.load_at_m[schedule.load_segment == segment])
        np.testing.assert_allclose(places, [0.034, at_m, 0.111])
    np.testing.assert_array_equal(np.isnan(schedule.load_at_m), schedule.load_segment == 0)
    for trial in range(25):  # every trial but the sweeps begins and ends where the last ended
        load_segments = schedule.load_segment[schedule.trial == trial]
        assert len(set(load_segments) - {0}) <= 1
        assert load_segments[-1] == 0


ARM = ideal_arm(NOMINAL)
SCHEDULE = draw_schedule(NOMINAL, np.random.default_rng(0)).rows(slice(14, 7 * 150, 42))
HISTORY = draw_history(NOMINAL, np.random.default_rng(1))
EVERY = {**LISTED, **UNLISTED}
PLACES = {"cable": 12, "segment": 4, "joint": 4}


@cache
def unchanged_n() -> Array:
    return ARM.signals_n(SCHEDULE, HISTORY)


@pytest.mark.parametrize("name", EVERY)
def test_every_change_shows_and_grows_with_its_size(name: str) -> None:
    change = EVERY[name](ArmDraw(np.random.default_rng(5), NOMINAL))
    assert change.effect == (name if name in LISTED else "unknown")
    assert change.unit
    for place in change.where:
        kind, number = place.split("_")
        assert 1 <= int(number) <= PLACES[kind]
    middle = float(change.least**0.1 * change.most**0.9)
    small, large = (
        gap_n(change.apply(ARM, size).signals_n(SCHEDULE, HISTORY), unchanged_n())
        for size in (0.5 * middle, middle)
    )
    assert 0.0 <= small < large or name == "sensor_dropouts"  # whose times are drawn anew
    assert large > 0.3 * NOMINAL.floor_n


def test_two_hidden_changes_are_visible_and_in_the_answer(tmp_path: Path) -> None:
    kind = "payload+sensor_gain"
    nominal = read_nominal(two_segments(tmp_path))
    recorded = make_case(nominal, 4, 1, kind)
    answer = recorded.answer
    assert answer.effects == kind
    alone = [float(gap) for gap in answer.each_gap_n.split()]
    assert min(alone) >= 5.0 * NOMINAL.floor_n
    assert [entry["unit"] for entry in json.loads(answer.sizes)] == ["kg", "1"]
    assert answer.where.startswith("cable_")
    assert "segment_" in answer.where
    assert answer.gap_over_floor == pytest.approx(answer.gap_n / 0.0724, rel=0.01)


@pytest.mark.parametrize("count", [1, 5, 97])
def test_a_fifth_hides_nothing_and_a_fifth_something_unlisted(count: int) -> None:
    kinds = draw_kinds(np.random.default_rng(count), count)
    assert len(kinds) == count
    if count < 5:
        return
    assert kinds.count("none") >= 0.2 * count
    assert sum(kind in UNLISTED for kind in kinds) >= 0.2 * count
    doubles = [kind for kind in kinds if "+" in kind]
    assert len(doubles) == round(0.12 * count)
    for kind in doubles:
        first, second = kind.split("+")
        assert first < second
        assert {first, second} <= set(LISTED)


def test_an_arm_of_five_segments_with_four_cables_is_recorded(tmp_path: Path) -> None:
    arm_file = tmp_path / "arm.yaml"
    arm_file.write_text(five_by_four_text("cdsm_lab"))
    nominal = read_nominal(arm_file)
    rng = np.random.default_rng(3)
    schedule = draw_schedule(nominal, rng)
    history = draw_history(nominal, rng)
    assert set(schedule.load_segment) == set(range(6))
    # as much more as 20 cables on 0.65 m bear than 12 on 0.52 m
    assert np.linalg.norm(schedule.load_n, axis=1).max() < 75.0 * 4 / 3
    change = LISTED["sensor_crosstalk"](ArmDraw(rng, nominal))
    assert all(1 <= int(place.split("_")[1]) <= 20 for place in change.where)
    rows = schedule.rows(slice(None, None, 40))
    arm = ideal_arm(nominal)
    changed = change.apply(arm, float(np.sqrt(change.least * change.most)))
    gap = gap_n(changed.signals_n(rows, history), arm.signals_n(rows, history))
    assert gap > 0.1
