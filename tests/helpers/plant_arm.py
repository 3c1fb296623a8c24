"""The plant of the bundled laboratory arm, shared by the tests of the plant."""

from pathlib import Path

from cablesense_base.installation import config_path
from cablesense_plants.arm.body import read_nominal

ARM_FILE = config_path("arms/cdsm_lab.yaml")
NOMINAL = read_nominal(ARM_FILE)
BODY = NOMINAL.body


def two_segments(folder: Path) -> Path:
    """The file of an arm of two segments that is read twice a second: quick to simulate."""
    file = folder / "arm.yaml"
    text = ARM_FILE.read_text()
    file.write_text(text.replace("count: 4", "count: 2").replace("rate_hz: 5", "rate_hz: 2"))
    return file
