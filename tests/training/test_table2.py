"""The paper's measured loads: read whole or refused, told right, and explained by our statics."""

import numpy as np
import pytest

from cablesense_base import CableSenseError
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.evaluation.comparison import SHIPPED, TABLE2_MODELS
from cablesense_training.evaluation.table2 import DOWN_DEG, evaluate_table2, read_table2
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model

HEADER = "source,load_kg,load_segment," + ",".join(f"cable_{i}_n" for i in range(1, 10))
ROW = "physical,1,2,1,2,3,4,5,6,7,8,9"


@pytest.fixture(scope="module")
def estimator():
    return Estimator.load(find_model(TABLE2_MODELS[SHIPPED]), open_arm("cdsm_table2"))


def test_the_table_has_two_loads_on_three_segments_from_two_sources():
    rows = read_table2()
    cases = {(row.source, row.segment, round(row.weight_n, 2)) for row in rows}
    expected = {
        (source, segment, weight)
        for source in ("physical", "simulated")
        for segment in (1, 2, 3)
        for weight in (9.81, 19.62)
    }
    assert cases == expected
    assert len(rows) == 12
    assert all(row.tension_difference_n.shape == (9,) for row in rows)


def test_physical_rows_are_whole_steps_of_the_sensor():
    step = open_arm("cdsm_table2").sensors.step_n
    physical = [row.tension_difference_n for row in read_table2() if row.source == "physical"]
    steps = np.array(physical) / step
    assert np.abs(steps - np.round(steps)).max() < 0.1


def test_every_hung_load_is_told_by_segment_direction_and_weight(estimator):
    answers = evaluate_table2(estimator)
    assert len(answers) == 6
    for answer in answers:
        assert answer.segment == answer.load.segment
        assert abs(answer.angle_error_deg) < 2.0
        assert abs(answer.magnitude_error) < 0.10
        assert answer.angle_deg - DOWN_DEG == pytest.approx(answer.angle_error_deg)
        weight = answer.load.weight_n
        assert answer.magnitude_n == pytest.approx(weight * (1.0 + answer.magnitude_error))


def test_simulated_rows_may_be_asked_for_too(estimator):
    assert [a.load.source for a in evaluate_table2(estimator, "simulated")] == ["simulated"] * 6


def test_the_papers_simulation_and_ours_agree_on_what_grows_with_the_load():
    mechanism = mechanism_of(open_arm("cdsm_table2"))
    rows = {(r.segment, round(r.weight_n)): r for r in read_table2() if r.source == "simulated"}
    errors = []
    for segment in (1, 2, 3):
        theirs = rows[segment, 20].tension_difference_n - rows[segment, 10].tension_difference_n
        ours = [
            solve_equilibrium(
                mechanism,
                np.zeros(6),
                normal_force_n(mechanism, np.zeros(6), segment, DOWN_DEG, weight),
            ).tensions_n
            for weight in (9.81, 19.62)
        ]
        errors.append(ours[1] - ours[0] - theirs)
    assert np.abs(errors).max() < 0.45
    assert np.sqrt(np.mean(np.square(errors))) < 0.2


@pytest.mark.parametrize(
    "content",
    [
        b"source,load_kg\nphysical,1\n",
        f"{HEADER}\n{ROW.replace('9', 'nine')}\n".encode(),
        f"{HEADER}\n{ROW.replace('9', 'nan')}\n".encode(),
        f"{HEADER}\n{ROW.replace(',9', '')}\n".encode(),
        f"{HEADER}\nphysical,1,two,1,2,3,4,5,6,7,8,9\n".encode(),
        f"{HEADER}\n".encode(),
        b"",
        b"\xff\xfe\x00",
    ],
    ids=["columns", "word", "nan", "short", "segment", "no rows", "empty", "bytes"],
)
def test_what_is_not_the_table_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "table.csv"
    path.write_bytes(content)
    with pytest.raises(CableSenseError, match="not Table II") as caught:
        read_table2(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_table_is_refused(tmp_path):
    with pytest.raises(CableSenseError, match="No such file"):
        read_table2(tmp_path / "none.csv")


def test_a_model_of_another_arm_is_refused():
    with pytest.raises(CableSenseError, match="cdsm_table2"):
        evaluate_table2(Estimator.load(find_model("cdsm")))
