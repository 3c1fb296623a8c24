"""The time of an answer is one of ONNX Runtime, in microseconds."""

import pytest

from cablesense_paper.network_findings import Shape
from cablesense_paper.network_trials import answer_us
from cablesense_sim.arm import open_arm

pytestmark = pytest.mark.slow  # exports a network


def test_an_answer_takes_microseconds():
    assert 1.0 < answer_us(Shape("shared trunk", 1, 8), open_arm("cdsm")) < 5_000.0
