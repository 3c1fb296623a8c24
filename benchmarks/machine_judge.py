"""A judge of a machine's readings, until the one of the package takes machines."""

from __future__ import annotations

from types import SimpleNamespace

from scipy.stats import chi2

from cablesense_contact.judgement import IMPROBABLE, Judge
from cablesense_sim.machine.machine import Machine


class MachineJudge(Judge):
    """Judges readings of one machine."""

    def __init__(self, machine: Machine) -> None:
        channels = len(machine.channels.names)
        described = SimpleNamespace(
            cable_names=machine.channels.names,
            touch=machine.source.file.touch,
            cable_count=max(channels, 5),
        )
        super().__init__(described)  # type: ignore[arg-type]
        self._free_limit = float(chi2.isf(IMPROBABLE, channels))
