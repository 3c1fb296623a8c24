"""The settings that estimators are compared in: which arm, which poses, which models answer."""

from __future__ import annotations

from dataclasses import dataclass

from cablesense_sim.arm import Arm
from cablesense_sim.arm_files import open_arm
from cablesense_training.data.protocols import MultiContact, Pose, SingleContact


@dataclass(frozen=True)
class Setting:
    """One column of the comparison.

    Attributes:
        name: as `cablesense evaluate --json` calls it.
        arm_name: bundled arm.
        pose: straight, or joints within ± 10 degrees.
        model: bundled model that CableSense ships for it.
        peers: bundled models to compare with, by the name the report uses.
    """

    name: str
    arm_name: str
    pose: Pose
    model: str
    peers: dict[str, str]

    @property
    def arm(self) -> Arm:
        """The arm's description."""
        return open_arm(self.arm_name)

    def protocol(self, samples: int) -> SingleContact:
        """0 to 200 N on any segment from any side, or nothing; sensor noise and step on."""
        return SingleContact(samples=samples, pose=self.pose)


SETTINGS = (
    Setting(
        "straight",
        "cdsm",
        "straight",
        "cdsm",
        {"closed_form": "peers/cdsm_closed_form", "two_stage": "peers/cdsm_straight_two_stage"},
    ),
    Setting(
        "random_pose",
        "cdsm",
        "random",
        "cdsm",
        {"closed_form": "peers/cdsm_closed_form", "two_stage": "peers/cdsm_two_stage"},
    ),
    Setting(
        "compliant",
        "cdsm_lab",
        "random",
        "cdsm_lab",
        {"closed_form": "peers/cdsm_lab_closed_form", "two_stage": "peers/cdsm_lab_two_stage"},
    ),
    Setting(
        "tensions_only",
        "cdsm",
        "random",
        "cdsm_tensions_only",
        {"two_stage": "peers/cdsm_two_stage"},
    ),
)
"""Single contact; random poses are known to the pose-aware models and unknown to the others."""

MULTI_ARM = "cdsm"
MULTI_MODEL = "cdsm_multi"
MULTI_PEERS = {"two_stage": "peers/cdsm_multi_two_stage"}
TABLE2_MODEL = "cdsm_table2"
TABLE2_MODELS = {
    "shipped": TABLE2_MODEL,
    "closed_form": "peers/cdsm_table2_closed_form",
    "two_stage": "peers/cdsm_table2_two_stage",
}
"""Models of the three-segment arm, by the name the report uses."""

WEAKEST_MULTI_N = 5.0
"""Multi-contact recognition is judged on forces of at least this."""


def multi_protocol(samples: int) -> MultiContact:
    """None to N contacts at once on the straight arm, sensor noise and step on."""
    return MultiContact(samples=samples, pose="straight")
