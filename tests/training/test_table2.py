"""The paper's measured loads: read whole or refused, told right, and explained by our statics."""

import pytest

from cablesense_base import CableSenseError
from cablesense_sim.arm import open_arm
from cablesense_training.evaluation.comparison import SHIPPED, TABLE2_MODELS
from cablesense_training.evaluation.table2 import DOWN_DEG, evaluate_table2
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model


@pytest.fixture(scope="module")
def estimator():
    return Estimator.load(find_model(TABLE2_MODELS[SHIPPED]), open_arm("cdsm_table2"))


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


def test_a_model_of_another_arm_is_refused():
    with pytest.raises(CableSenseError, match="cdsm_table2"):
        evaluate_table2(Estimator.load(find_model("cdsm")))
