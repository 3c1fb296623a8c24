"""All checks of a recording, as one report."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.channel_checks import channel_findings
from cablesense_gap.recordings.finding import Finding, RecordingReport, Severity, refuse, warn
from cablesense_gap.recordings.form_checks import form_findings
from cablesense_gap.recordings.recording import Recording
from cablesense_sim.arm import Arm

Array = NDArray[np.float64]

FEWEST_ROWS, FEWEST_TRIALS = 6, 2
"""Below these nothing can be held out."""
GOOD_ROWS, GOOD_TRIALS = 200, 8


def check_recording(
    recording: Recording, arm: Arm, nominal_n: Array | None = None
) -> RecordingReport:
    """What is wrong with a recording that is to be diagnosed, the worst first.

    Args:
        recording: as read, or made.
        arm: the nominal arm.
        nominal_n: (R, M) tensions that the nominal arm predicts for the rows. Without them nothing
            is said of exchanged channels and other arms.
    """
    findings = form_findings(recording, arm)
    if all(finding.severity is not Severity.REFUSE for finding in findings):
        findings += _amount(recording)
        findings += channel_findings(recording, arm, nominal_n)
    ordered = sorted(findings, key=lambda finding: finding.severity is not Severity.REFUSE)
    return RecordingReport(recording.name, tuple(ordered))


def check_form(recording: Recording, arm: Arm) -> RecordingReport:
    """What is wrong with a recording by itself, whatever it is for: shapes, numbers, labels."""
    return RecordingReport(recording.name, tuple(form_findings(recording, arm)))


def _amount(recording: Recording) -> list[Finding]:
    rows, trials = len(recording), len(np.unique(recording.trial))
    if rows < FEWEST_ROWS or trials < FEWEST_TRIALS:
        return [
            refuse(
                "amount",
                f"has {rows} rows in {trials} trials; a diagnosis needs at least {FEWEST_ROWS} "
                f"rows in {FEWEST_TRIALS} trials, since it judges on trials it has not seen",
            )
        ]
    if rows < GOOD_ROWS or trials < GOOD_TRIALS:
        return [
            warn(
                "amount",
                f"has only {rows} rows in {trials} trials; `cablesense gap protocol` says what to "
                "record so that effects can be told apart",
            )
        ]
    return []
