"""Channels beside what the arm file predicts, where a recording has loads or poses to tell by."""

from __future__ import annotations

import numpy as np

from cablesense_gap.recordings.channel_checks import channel_findings
from cablesense_gap.recordings.finding import Severity
from cablesense_gap.recordings.recording import Recording
from cablesense_ros.commissioning.sensor_check import SensorFinding
from cablesense_sim.arm import Arm
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.mechanism import Mechanism

MOST_ROWS = 20_000
"""Predicted within a second or two; longer recordings are thinned out."""

_KINDS = ("swapped", "stuck", "arm", "unit")
"""The others are told by the sensors' own figures."""


def exercised_channel_findings(recording: Recording, arm: Arm) -> list[SensorFinding]:
    """Exchanged or dead channels and wrong units, by the nominal arm; empty without movement.

    Raises:
        CableSenseError: the arm has no rest under one of the loads.
    """
    if not (np.ptp(recording.command_rad, axis=0).any() or recording.load_n.any()):
        return []
    every = -(-len(recording) // MOST_ROWS)
    recording = recording.rows(slice(None, None, every))
    nominal = solve_equilibrium(Mechanism.from_arm(arm), recording.command_rad, recording.forces_n)
    counted = f" (rows count one sample in {every})" if every > 1 else ""
    return [
        SensorFinding(True, finding.kind, "all", finding.text + counted)
        for finding in channel_findings(recording, arm, nominal.tensions_n)
        if finding.kind in _KINDS or finding.severity is Severity.REFUSE
    ]
