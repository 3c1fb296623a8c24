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


def test_a_model_of_another_arm_is_refused():
    with pytest.raises(CableSenseError, match="cdsm_table2"):
        evaluate_table2(Estimator.load(find_model("cdsm")))
