"""The folder that a diagnosis leaves."""

from __future__ import annotations

import pytest
from gap_recordings import LAB, small_recording
from verdict_cases import verdict_of

from cablesense_gap.arm_simulator import amended_arm
from cablesense_gap.diagnose import Diagnosis
from cablesense_gap.report.page import write_diagnosis
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import VerdictError, read_verdict
from cablesense_sim.arm import load_arm

RECORDING = small_recording()
FOUND = Diagnosis(
    verdict=verdict_of("payload", 0.95, segments=("segment_2",)),
    amended=amended_arm(LAB, {Term("payload", "segment_2", "mass_kg"): 0.3}, {}),
    predicted_before_n=RECORDING.tensions_n - 3.0,
    predicted_after_n=RECORDING.tensions_n + 0.2,
    held_out_n=RECORDING.tensions_n + 0.2,
    findings=("cable_3 stands still",),
)


@pytest.mark.slow  # the report's pictures
def test_it_holds_the_verdict_the_amended_arm_and_the_report(tmp_path):
    folder = tmp_path / "new" / "diagnosis"
    write_diagnosis(folder, RECORDING, LAB, FOUND)
    assert {path.name for path in folder.iterdir()} == {"verdict.json", "arm.yaml", "report.html"}
    assert read_verdict(folder / "verdict.json") == FOUND.verdict
    assert load_arm(folder / "arm.yaml") == FOUND.amended
    headline = (folder / "arm.yaml").read_text(encoding="utf-8").splitlines()[0]
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert headline.removeprefix("# ") in page
    assert "cable_3 stands still" in page


def test_a_folder_that_cannot_be_made_is_told_in_a_line(tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(VerdictError, match="cannot be made") as told:
        write_diagnosis(tmp_path / "file" / "diagnosis", RECORDING, LAB, FOUND)
    assert "\n" not in str(told.value)
