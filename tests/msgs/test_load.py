"""A load is a finite force on a segment, without torque."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from cablesense_msgs_py.topics import ContractError, Frames
from cablesense_msgs_py.wrenches import read_load

FRAMES = Frames(4)


def message(force=(0.0, 0.0, 0.0), torque=(0.0, 0.0, 0.0), frame="segment_2"):
    vector = lambda v: SimpleNamespace(x=v[0], y=v[1], z=v[2])  # noqa: E731
    return SimpleNamespace(
        header=SimpleNamespace(frame_id=frame),
        wrench=SimpleNamespace(force=vector(force), torque=vector(torque)),
    )


def test_reads_segment_and_force():
    load = read_load(message((1.0, -2.0, 3.0)), FRAMES)
    assert load.segment == 2
    np.testing.assert_array_equal(load.force_base_n, [1.0, -2.0, 3.0])


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"force": (math.nan, 0.0, 0.0)}, "wrench.force"),
        ({"force": (math.inf, 0.0, 0.0)}, "wrench.force"),
        ({"force": (1e6, 0.0, 0.0)}, "at most 2000 N"),
        ({"torque": (0.0, 0.1, 0.0)}, "must be zero"),
        ({"torque": (0.0, math.nan, 0.0)}, "must be zero"),
        ({"frame": "segment_9"}, "segment_1 … segment_4"),
    ],
)
def test_refuses_what_is_no_load(wrong, complaint):
    with pytest.raises(ContractError, match=complaint):
        read_load(message(**wrong), FRAMES)
