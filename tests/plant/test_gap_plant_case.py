"""Cases: what is hidden, how much of it, and what is told of it."""

import json
import pickle

import numpy as np
import pytest
from gap_plant import NOMINAL, first_rows

from cablesense_gap.plant.arm import ideal_arm, signals_n
from cablesense_gap.plant.body import PlantError
from cablesense_gap.plant.case import draw_case, every, gap_n, record_case, size_for
from cablesense_gap.plant.listed import LISTED
from cablesense_gap.plant.protocol import draw_history, draw_schedule
from cablesense_gap.plant.unlisted import UNLISTED

ARM = ideal_arm(NOMINAL)
WHOLE = draw_schedule(NOMINAL, np.random.default_rng(0))
SCHEDULE = first_rows(every(WHOLE, 7), 150)
HISTORY = draw_history(NOMINAL, np.random.default_rng(1))
WITHOUT = signals_n(ARM, SCHEDULE, HISTORY)
EVERY = {**LISTED, **UNLISTED}
PLACES = {"cable": 12, "segment": 4, "joint": 4}


@pytest.mark.parametrize("name", list(EVERY))
def test_every_change_shows_and_grows_with_its_size(name: str) -> None:
    change = EVERY[name](np.random.default_rng(5), NOMINAL)
    assert change.effect == (name if name in LISTED else "unknown")
    assert change.unit
    for place in change.where:
        kind, number = place.split("_")
        assert 1 <= int(number) <= PLACES[kind]
    pickle.dumps(change)  # so that cases go to other processes
    middle = float(change.least**0.1 * change.most**0.9)
    small, large = (
        gap_n(signals_n(change.apply(ARM, size), SCHEDULE, HISTORY), WITHOUT)
        for size in (0.5 * middle, middle)
    )
    assert 0.0 <= small < large or name == "sensor_dropouts"  # whose times are drawn anew
    assert large > 0.3 * NOMINAL.floor_n


@pytest.mark.parametrize("name", list(LISTED))
def test_forms_differ_from_one_case_to_the_next(name: str) -> None:
    drawn = [LISTED[name](np.random.default_rng(seed), NOMINAL) for seed in range(12)]
    assert len({(change.form, change.where) for change in drawn}) > 1


def test_the_size_meets_the_gap_that_is_wanted() -> None:
    for name in ("payload", "sensor_gain"):
        change = LISTED[name](np.random.default_rng(2), NOMINAL)
        size = size_for(change, ARM, 1.0, WHOLE, HISTORY)
        changed = signals_n(change.apply(ARM, size), WHOLE, HISTORY)
        assert gap_n(changed, signals_n(ARM, WHOLE, HISTORY)) == pytest.approx(1.0, rel=0.15)


def test_a_case_is_its_seed() -> None:
    first, again, other = (
        record_case(draw_case(np.random.default_rng(seed), 3, NOMINAL, "sensor_gain"))
        for seed in (8, 8, 9)
    )
    np.testing.assert_array_equal(first.tensions_n, again.tensions_n)
    assert first.answer == again.answer
    assert first.answer.recording == "case_003"
    assert (first.tensions_n != other.tensions_n).any()


def test_nothing_hidden_leaves_the_scatter() -> None:
    answer = record_case(draw_case(np.random.default_rng(0), 1, NOMINAL, "none")).answer
    assert (answer.effects, answer.where, answer.form, answer.gap_n) == ("none", "", "", 0.0)
    assert 0.05 < answer.scatter_gap_n < 0.5


def test_two_hidden_are_both_visible_and_both_told() -> None:
    kind = "payload+sensor_gain"
    recorded = record_case(draw_case(np.random.default_rng(4), 1, NOMINAL, kind))
    answer = recorded.answer
    assert answer.effects == kind
    alone = [float(gap) for gap in answer.each_gap_n.split()]
    assert min(alone) >= 5.0 * NOMINAL.floor_n
    assert [entry["unit"] for entry in json.loads(answer.sizes)] == ["kg", "1"]
    assert answer.where.startswith("cable_")
    assert "segment_" in answer.where
    assert answer.gap_over_floor == pytest.approx(answer.gap_n / 0.0724, rel=0.01)


def test_what_is_outside_the_list_is_told_as_unknown_and_its_form() -> None:
    answer = record_case(draw_case(np.random.default_rng(1), 1, NOMINAL, "wall")).answer
    assert (answer.effects, answer.form, answer.where) == ("unknown", "wall", "")


@pytest.mark.parametrize("kind", ["paylod", "payload+wall", "none+payload"])
def test_kinds_that_are_none_are_refused(kind: str) -> None:
    with pytest.raises(PlantError, match="no effect"):
        draw_case(np.random.default_rng(0), 1, NOMINAL, kind)
