"""The simulation of a file: of an arm of an arm file, or of a machine that MuJoCo describes."""

from __future__ import annotations

from cablesense_online.simulation import Simulation, SimulationSettings
from cablesense_sim.machine.description import is_machine_file


def open_simulation(name: str, settings: SimulationSettings, now_s: float) -> Simulation:
    """The simulation of a bundled arm, an arm file or a machine file.

    Raises:
        CableSenseError: the file is missing or invalid, or the machine finds no rest.
    """
    if is_machine_file(name):
        from cablesense_online.machine_simulation import MachineSimulation
        from cablesense_sim.machine.machine import open_machine

        return MachineSimulation(open_machine(name), settings, now_s)
    from cablesense_online.arm_simulation import ArmSimulation
    from cablesense_sim.arm import open_arm

    return ArmSimulation(open_arm(name), settings, now_s)
