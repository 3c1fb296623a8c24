"""The machine of the sim node: at rest at each reading, under the forces that act then."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Load
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.loads import LoadError
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce


class MovingMachine:
    """A simulated machine with smooth commands, and loads on its links.

    Attributes:
        machine: the machine.
        loads: those that act, by the number of the link from 1.
        refusals: how often it found no rest, and stayed where it was.
    """

    def __init__(self, machine: Machine, joint_speed_rad_s: float, built_seed: int = -1) -> None:
        """By its model, or by `built_seed` with errors of its own within its tolerances."""
        self.machine = machine
        self.loads: dict[int, Load] = {}
        self.refusals = 0
        parameters = MachineParameters(machine)
        theta = np.zeros(len(parameters))
        if built_seed >= 0:
            theta = parameters.drawn(np.random.default_rng(built_seed))
        self._simulated = SimulatedMachine(machine, parameters, theta)
        start = Holding(machine).command_of(machine.reference)
        self._motion = JointMotion.at_rest(start, joint_speed_rad_s)
        self._rest = self._simulated.untouched(start)

    @property
    def target(self) -> Array:
        """(C,) the last command."""
        return self._motion.target_rad

    def go_to(self, command: Array) -> None:
        """Begin to move to a command (C,)."""
        self._motion = self._motion.towards(command)

    def push(self, load: Load) -> None:
        """Replace the load on a link; a zero force removes it.

        Raises:
            LoadError: the place is not on the link.
        """
        name = self.machine.links.names[load.segment - 1]
        first_m, last_m = self.machine.links.touched_m[load.segment - 1]
        place_m = load.contact_m
        if place_m is not None and not first_m <= place_m <= last_m:
            raise LoadError(
                f"{place_m:.4f} m is not on {name}, which is touched from {first_m:.4f} to "
                f"{last_m:.4f} m along its axis"
            )
        self.loads.pop(load.segment, None)
        if load.force_base_n.any():
            self.loads[load.segment] = load

    def advance(self, seconds: float) -> None:
        """Move on, and come to rest there."""
        if self._motion.moving:
            self._motion = self._motion.after(seconds)
        forces = [
            LinkForce(number - 1, self._point_m(load), load.force_base_n)
            for number, load in self.loads.items()
        ]
        try:
            self._rest = self._simulated.under(self._motion.angle_rad, forces, self._rest.pose)
        except MachineError:
            self.refusals += 1

    def reading(self, rng: np.random.Generator | None) -> Array:
        """(M,) what the sensors read; without noise and step without `rng`."""
        return self.machine.channels.read(self._rest.values, rng)

    def measured(self) -> Array:
        """(n,) where the joints are, as encoders read it."""
        if self.machine.is_measured:
            return self._motion.angle_rad
        return self._rest.pose

    def _point_m(self, load: Load) -> Array:
        middle_m = float(self.machine.links.touched_m[load.segment - 1].mean())
        return np.array([middle_m if load.contact_m is None else load.contact_m, 0.0, 0.0])
