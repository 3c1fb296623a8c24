"""The machine of a file, to be shown: an arm of an arm file, or one that MuJoCo describes."""

from __future__ import annotations

from cablesense_online.page.shown import ShownMachine
from cablesense_sim.machine.description import is_machine_file


def shown_machine(name: str) -> ShownMachine:
    """By the name of a bundled arm, or by the path of an arm file or a machine file.

    Raises:
        CableSenseError: the file is missing or invalid.
    """
    if is_machine_file(name):
        from cablesense_online.page.shown_model import ShownModel
        from cablesense_sim.machine.machine import open_machine

        return ShownModel(open_machine(name))
    from cablesense_online.page.shown_arm import ShownArm
    from cablesense_sim.arm import open_arm

    return ShownArm(open_arm(name))
