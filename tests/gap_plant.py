"""The plant of the bundled laboratory arm, shared by the tests of the plant."""

from dataclasses import replace

import numpy as np

from cablesense_base.installation import config_path
from cablesense_gap.plant.body import read_nominal, stiff_body
from cablesense_gap.plant.protocol import Schedule

ARM_FILE = config_path("arms/cdsm_lab.yaml")
NOMINAL = read_nominal(ARM_FILE)
BODY = stiff_body(NOMINAL)


def first_rows(schedule: Schedule, rows: int) -> Schedule:
    return replace(
        schedule,
        time_s=schedule.time_s[:rows],
        trial=schedule.trial[:rows],
        command_rad=schedule.command_rad[:rows],
        load_segment=schedule.load_segment[:rows],
        load_n=schedule.load_n[:rows],
    )


def pushes(
    shares: np.ndarray, segment: int, peak_n: tuple[float, float, float], command: np.ndarray
) -> Schedule:
    """A load that takes shares of its peak, one a row, at one command."""
    rows = len(shares)
    load = np.outer(shares, peak_n)
    return Schedule(
        time_s=0.2 * np.arange(rows),
        trial=np.zeros(rows, dtype=int),
        command_rad=np.tile(command, (rows, 1)),
        load_segment=np.where((load != 0.0).any(axis=1), segment, 0),
        load_n=load,
    )
