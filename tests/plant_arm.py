"""The plant of the bundled laboratory arm, shared by the tests of the plant."""

from pathlib import Path

from cablesense_base.installation import config_path
from cablesense_plants.arm.body import read_nominal, rigid_body

ARM_FILE = config_path("arms/cdsm_lab.yaml")
NOMINAL = read_nominal(ARM_FILE)
BODY = rigid_body(NOMINAL)


def two_segments(folder: Path) -> Path:
    """The file of an arm like that of the laboratory, of two segments: quick to simulate."""
    file = folder / "arm.yaml"
    file.write_text(ARM_FILE.read_text().replace("count: 4", "count: 2"))
    return file
