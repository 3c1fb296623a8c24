"""Diagnoses the gap of one's own robot: an MJCF and a recording of it.

    python -m examples.own_robot robot.xml recording.csv

docs/robot.md describes the recording; `cablesense gap protocol --model robot.xml` what to record.
"""

from __future__ import annotations

import sys

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.recording import read_recording
from cablesense_gap.robot.system import diagnose


def main(model: str, recording: str) -> None:
    """Print the effects that explain the gap, with their values and probability."""
    robot = load_robot(model)
    verdict = diagnose(read_recording(recording, robot), robot).verdict
    print("effects:", ", ".join(verdict.effects), f"({verdict.probability:.0%})")
    for parameter, value in verdict.parameters.items():
        print(f"  {parameter}: {value}")


if __name__ == "__main__":
    main(*sys.argv[1:3])
