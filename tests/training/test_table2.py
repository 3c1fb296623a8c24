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
    for load, found in answers:
        assert found.segment == load.segment
        assert found.angle_deg == pytest.approx(DOWN_DEG, abs=2.0)
        assert found.magnitude_n == pytest.approx(load.weight_n, rel=0.10)


def test_a_model_of_another_arm_is_refused():
    with pytest.raises(CableSenseError, match="cdsm_table2"):
        evaluate_table2(Estimator.load(find_model("cdsm")))
