"""On arms of any size and stiffness, what is to be recorded stays within what they bear."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arm_variants import variant
from gap_arms import draw_arm

from cablesense_gap.amended_arm import write_arm
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.recordings.protocol import rows_of, standard_protocol
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.withhold import withhold
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.replay import replay_arm

SOFT = variant(
    {
        "segments.count": 3,
        "cables.per_segment": 4,
        "cables.angle_deg": {"first": 0, "per_segment": 30, "per_cable": -90},
        "cables.stiffness_n_m": 8e3,
    },
    "cdsm_lab",
)
ARMS = [SOFT, *(draw_arm(np.random.default_rng(seed)) for seed in (1, 2))]


@pytest.mark.parametrize("arm", ARMS, ids=["soft", "drawn", "another"])
def test_loads_follow_what_the_arm_bears(arm: Arm, tmp_path: Path) -> None:
    rows = rows_of(standard_protocol(arm), 1.0)
    placed = replace(mechanism_of(arm), contact_m=np.nan_to_num(rows.inputs[3]))
    solve_equilibrium(placed, rows.command_rad, 1.2 * rows.forces_n)  # raises where none is found
    assert np.linalg.norm(rows.load_n, axis=1).max() > 0.0
    file = tmp_path / "arm.yaml"
    write_arm(file, arm, "")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        list(
            withhold(
                tmp_path,
                tmp_path / "a.csv",
                replace(read_nominal(file), rate_hz=5.0),
                1,
                5,
                ["none"],
            )
        )
    read = read_recording(tmp_path / "case_001.csv", arm)
    replay_arm(arm, *read.inputs)  # raises where the arm as drawn has no equilibrium
    assert set(read.load_segment) == set(range(arm.segment_count + 1))
