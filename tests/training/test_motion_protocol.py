"""A motion protocol that cannot be is refused, naming what would be right."""

import pytest

from cablesense_training.errors import DatasetError
from cablesense_training.motion.motion_protocol import MotionProtocol


def test_ticks_fill_the_duration():
    assert MotionProtocol(duration_s=3.0, tick_s=0.02).ticks == 150


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("sequences", 0),
        ("duration_s", float("nan")),
        ("tick_s", 0.0),
        ("pose_range_deg", 90.0),
        ("joint_speed_deg_s", float("inf")),
        ("force_high_n", -1.0),
        ("tare_samples", 0),
    ],
)
def test_a_value_out_of_range_is_refused(name, value):
    with pytest.raises(DatasetError, match=rf"{name} = .*: must be a number from"):
        MotionProtocol(**{name: value})
