"""The plant of the bundled laboratory arm, shared by the tests of the plant."""

from cablesense_base.installation import config_path
from cablesense_plants.arm.body import read_nominal, rigid_body

ARM_FILE = config_path("arms/cdsm_lab.yaml")
NOMINAL = read_nominal(ARM_FILE)
BODY = rigid_body(NOMINAL)
