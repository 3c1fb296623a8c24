"""Exchanged channels in a recording, by what loads and poses do to each cable."""

from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_online.commissioning.sensor_check import exercised_channel_findings
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium


@pytest.fixture(scope="module")
def recording():
    made = small_recording()
    nominal = solve_equilibrium(mechanism_of(LAB), made.command_rad, made.forces_n)
    draw = np.random.default_rng(0)
    return replace(
        made, tensions_n=nominal.tensions_n + draw.normal(0.0, 0.05, nominal.tensions_n.shape)
    )


def test_channels_as_they_should_be_give_nothing(recording):
    assert exercised_channel_findings(recording, LAB) == []


def test_an_exchange_is_found(recording):
    swapped_n = recording.tensions_n.copy()
    swapped_n[:, [1, 6]] = swapped_n[:, [6, 1]]
    (finding,) = exercised_channel_findings(replace(recording, tensions_n=swapped_n), LAB)
    assert finding.wrong
    assert finding.kind == "swapped"
    assert "tension_2_n reads cable_7" in finding.text


def test_an_arm_that_was_left_alone_tells_nothing(recording):
    still = recording.rows(slice(0, 20))
    assert exercised_channel_findings(still, LAB) == []


def test_a_long_recording_is_thinned_out_and_says_so(recording, monkeypatch):
    module = "cablesense_online.commissioning.sensor_check.MOST_ROWS"
    monkeypatch.setattr(module, len(recording) // 2)
    swapped_n = recording.tensions_n.copy()
    swapped_n[:, [1, 6]] = swapped_n[:, [6, 1]]
    (finding,) = exercised_channel_findings(replace(recording, tensions_n=swapped_n), LAB)
    assert "one sample in" in finding.text
