"""History-dependent states, from the first rows of a new recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_gap.arm_simulator import removed_on, settled
from cablesense_sim.arm import ListedEffect
from cablesense_sim.replay import replay_arm


def loose(start: float):
    play = {"play_m": 2e-4, "start": start}
    return LAB.model_copy(
        update={
            "effects": [ListedEffect(effect="actuator_backlash", at="cable_5", parameters=play)]
        }
    )


@pytest.mark.parametrize("start", [-0.8, 0.6])
def test_where_a_play_stands_is_found_from_the_first_rows(start):
    recording = small_recording(peak_n=25.0)
    told = recording.time_s, recording.command_rad, recording.forces_n
    new = replace(recording, tensions_n=replay_arm(loose(start), *told))
    found = settled(loose(0.0), new, 30)
    assert found.effects[0].parameters["start"] == pytest.approx(start, abs=0.05)
    assert found.effects[0].parameters["play_m"] == 2e-4
    np.testing.assert_allclose(replay_arm(found, *told), new.tensions_n, atol=0.1)


def test_a_gap_is_removed_on_a_new_recording_once_its_past_is_known():
    recording = small_recording(peak_n=25.0)
    told = recording.time_s, recording.command_rad, recording.forces_n
    new = replace(recording, tensions_n=replay_arm(loose(-0.8), *told))
    unsettled, known = (removed_on(new, LAB, loose(0.9), rows, 0.01) for rows in (0, 30))
    assert unsettled < 0.9 < 0.97 < known


def test_an_arm_without_such_states_stays():
    assert settled(LAB, small_recording(peak_n=25.0), 30) is LAB
