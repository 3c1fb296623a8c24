"""What `--plain` hides shows on arms of every size, as the tutorial needs it."""

import pytest
import yaml

from cablesense_plants.arm.blind_cases import make_case
from cablesense_plants.arm.body import read_nominal
from tests.helpers.arm_variants import SOFT_CABLES, five_by_four, variant

ARMS = {"five by four": five_by_four("cdsm_lab"), "soft": variant(SOFT_CABLES, "cdsm_lab")}


@pytest.mark.slow
@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("seed", [3, 4])
def test_a_plain_gain_shows_on_any_arm(name, seed, tmp_path):
    sensors = ARMS[name].sensors.model_copy(update={"rate_hz": 1.0})
    arm = ARMS[name].model_copy(update={"sensors": sensors})
    path = tmp_path / "arm.yaml"
    path.write_text(yaml.safe_dump(arm.model_dump(mode="json")), encoding="utf-8")
    case = make_case(read_nominal(path), seed, 1, "sensor_gain", plain=True)
    assert case.answer.gap_over_floor > 4.0
