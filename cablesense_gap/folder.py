"""The folder that a diagnosis leaves: `verdict.json`, `arm.yaml` and `report.html`."""

from __future__ import annotations

from pathlib import Path

from cablesense_gap.amending import write_arm
from cablesense_gap.diagnose import Diagnosis
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.report.inputs import ReportInputs
from cablesense_gap.report.page import write_report
from cablesense_gap.report.wording import headline
from cablesense_gap.verdict import VerdictError, write_verdict
from cablesense_sim.arm import Arm


def write_diagnosis(folder: Path, recording: Recording, arm: Arm, found: Diagnosis) -> None:
    """Write all three files.

    Raises:
        VerdictError: the folder cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise VerdictError(f"{folder}: cannot be made ({error.strerror or error})") from error
    write_verdict(folder / "verdict.json", found.verdict)
    write_arm(folder / "arm.yaml", found.amended, headline(found.verdict))
    write_report(
        folder / "report.html",
        ReportInputs(
            recording=recording,
            arm=arm,
            verdict=found.verdict,
            predicted_before_n=found.predicted_before_n,
            predicted_after_n=found.predicted_after_n,
            held_out_n=found.held_out_n,
            findings=found.findings,
        ),
    )
