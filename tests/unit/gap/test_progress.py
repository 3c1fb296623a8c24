"""What a diagnosis shows while it works: a bar for each stage, and a time that is told once."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from cablesense_gap.diagnosis.duration import STAGES
from cablesense_ros.cli.options import diagnosis_progress, duration_text


def test_every_stage_has_a_bar_of_its_own_and_none_states_a_time_left():
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    with diagnosis_progress(console) as progress:
        progress.show("predicting the nominal arm", 0.0)
        progress.announce(185.0)
        for done in (0.1, 0.5, 0.8, 0.96, 1.0):
            progress.show("payload + sensor_gain", done)
    text = console.file.getvalue()
    assert "This takes about 3 min." in text
    for name, _ in STAGES:
        assert name in text
    assert "left" not in text


@pytest.mark.parametrize(
    ("seconds", "text"), [(3.0, "10 s"), (34.0, "30 s"), (130.0, "2 min"), (1800.0, "30 min")]
)
def test_a_time_has_the_digits_that_are_known(seconds, text):
    assert duration_text(seconds) == text
