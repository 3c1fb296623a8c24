"""Time and memory of the diagnosis of a long recording: the protocol at 1 kHz, read from CSV.

    python benchmarks/gap_long.py [--rate-hz 1000] [--write]

The arm has a payload and its sensors' noise. The diagnosis runs as a user runs it, in a process of
its own with two workers; its memory is that of all processes together.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import harness
import numpy as np

from cablesense_gap.recordings.csv_file import write_csv
from cablesense_gap.recordings.protocol import rows_of, standard_protocol
from cablesense_gap.verdict import read_verdict
from cablesense_sim.arm import open_arm
from cablesense_sim.replay import read_tensions_n, replay_arm

RESULT = "gap_long.json"
ARM = "cdsm_lab"
PAYLOAD = {"effect": "payload", "at": "segment_3", "parameters": {"mass_kg": 0.1}}


def main() -> None:
    """Makes the recording, diagnoses it, prints; keeps the numbers with `--write`."""
    parser = harness.parser(__doc__, f"results/{RESULT}")
    parser.add_argument("--rate-hz", type=float, default=1000.0, help="of the recording")
    options = parser.parse_args()
    nominal = open_arm(ARM)
    heavy = nominal.model_validate({**nominal.model_dump(), "effects": [PAYLOAD]})
    asked = rows_of(standard_protocol(nominal), options.rate_hz)
    ideal = replay_arm(heavy, asked.time_s, asked.command_rad, asked.forces_n)
    read = read_tensions_n(ideal, nominal.sensors, np.random.default_rng(0))
    with tempfile.TemporaryDirectory() as name:
        recording, out = Path(name) / "long.csv", Path(name) / "out"
        write_csv(recording, replace(asked, tensions_n=read))
        command = [*harness.CABLESENSE, "gap", "diagnose", str(recording), "--arm", ARM]
        seconds, peak_mb = harness.run_watched([*command, "--out", str(out), "--workers", "2"])
        verdict, size_mb = read_verdict(out / "verdict.json"), recording.stat().st_size / 1e6
    result = {
        **harness.origin(),
        "rows": verdict.rows,
        "rows_used": verdict.rows_used,
        "recording_mb": round(size_mb),
        "seconds": round(seconds, 1),
        "peak_memory_mb": round(peak_mb),
        "effects": list(verdict.effects),
        "places": list(verdict.where.places),
        "probability": round(verdict.probability, 3),
        "mass_kg": round(verdict.parameters["payload.mass_kg"].value, 4),
    }
    harness.publish(RESULT, result, options)


if __name__ == "__main__":
    main()
