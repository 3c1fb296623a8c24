"""Writes what is known of an arm as plain doubles, for programs that read no NumPy archive.

    python -m examples.cpp_estimator.known ARM known.bin [CALIBRATION]

Mean (P,) and covariance (P, P) of the arm's parameters, by a calibration file or by the tolerances
of the arm file.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from cablesense_contact.calibration_file import read_calibration
from cablesense_contact.felt_arm import FeltArm
from cablesense_sim import open_arm
from cablesense_sim.uncertain_arm import arm_parameters


def main(arm: str, out: str, calibration: str = "") -> None:
    """Write `out`."""
    description = open_arm(arm)
    if calibration:
        known = read_calibration(calibration, FeltArm(description))
        mean = known.mean
        covariance = known.covariance
    else:
        parameters = arm_parameters(description)
        mean = parameters.prior_mean
        covariance = np.diag(parameters.prior_std**2)
    Path(out).write_bytes(mean.tobytes() + covariance.tobytes())


if __name__ == "__main__":
    main(*sys.argv[1:])
