"""The example of the public surface runs, and says what is true."""

import re
from dataclasses import replace

import numpy as np
import pytest

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.simulator import Term
from cablesense_recording.csv_file import write_csv
from cablesense_sim.replay import read_tensions_n
from tests.helpers.checkout import CHECKOUT
from tests.helpers.gap_recordings import LAB, small_recording

PAGE = (CHECKOUT / "docs" / "api.md").read_text(encoding="utf-8")


@pytest.mark.slow  # one diagnosis
def test_the_example_estimates_the_push_and_finds_the_payload(tmp_path, monkeypatch):
    every = small_recording(peak_n=25.0)
    rows = every.rows(np.arange(0, len(every), 4))
    truth = {Term("payload", "segment_3", "mass_kg"): 0.5}
    ideal_n = ArmSimulator(LAB, rows).predict([truth])[0]
    read_n = read_tensions_n(ideal_n, LAB.sensors, np.random.default_rng(0))
    write_csv(tmp_path / "recording.csv", replace(rows, tensions_n=read_n))
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    values: dict = {}
    exec(compile(example, "docs/api.md", "exec"), values)
    verdict = values["found"].verdict
    touch = values["touch"]
    assert touch.link == "segment_3"
    assert touch.angle_deg == pytest.approx(215.0, abs=0.5)
    assert touch.magnitude_n == pytest.approx(40.0, abs=0.5)
    assert f"print(touch)  # {touch}\n" in PAGE
    assert verdict.effects == ("payload",)
    assert verdict.gap.removed_fraction > 0.9
