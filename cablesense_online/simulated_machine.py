"""The machine of the sim node: at rest at each reading, under the forces that act then."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_contact.machine.observation import Observer
from cablesense_msgs_py.messages import Load
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.loads import LoadError
from cablesense_sim.machine.built_machine import BuiltMachine
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.statics import LinkForce, force_on


class SimulatedMachine:
    """A machine at rest, with smooth commands and loads on its links.

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
        self._built = BuiltMachine(machine, parameters, theta)
        self._holding = Holding(machine)
        self._observer = Observer(machine)
        start = self._observer.command_of(machine.reference)
        self._motion = JointMotion.at_rest(start, joint_speed_rad_s)
        self._pose = machine.reference.copy()
        self._tensions_n = np.zeros(len(machine.tendons.ids))
        self._torques = np.zeros(len(machine.coordinates))
        self._settle()

    @property
    def target(self) -> Array:
        """(C,) the last command."""
        return self._motion.target_rad

    @property
    def pose(self) -> Array:
        """(n,) where the joints are."""
        return self._pose

    def go_to(self, command: Array) -> None:
        """Begin to move to a command (C,)."""
        self._motion = self._motion.towards(command)

    def push(self, load: Load) -> None:
        """Replace the load on a link; a zero force removes it.

        Raises:
            LoadError: the place is not on the link.
        """
        first_m, last_m = self.machine.links.touched_m[load.segment - 1]
        place_m = load.contact_m
        if place_m is not None and not first_m <= place_m <= last_m:
            raise LoadError(
                f"{place_m:.4f} m is not on {self.machine.links.names[load.segment - 1]}, which "
                f"is touched from {first_m:.4f} to {last_m:.4f} m along its axis"
            )
        self.loads.pop(load.segment, None)
        if load.force_base_n.any():
            self.loads[load.segment] = load

    def advance(self, seconds: float) -> None:
        """Move on, and come to rest there."""
        if self._motion.moving:
            self._motion = self._motion.after(seconds)
        self._settle()

    def reading(self, rng: np.random.Generator | None) -> Array:
        """(M,) what the sensors read; without noise and step without `rng`."""
        channels = self.machine.channels
        is_tension = channels.tendon >= 0
        values = np.empty(len(channels.names))
        values[is_tension] = self._tensions_n[channels.tendon[is_tension]]
        values[~is_tension] = self._torques[channels.coordinate[~is_tension]]
        return channels.read(self._built.gain * values + self._built.zero, rng)

    def measured(self) -> Array:
        """(n,) what the encoders read."""
        zero = self._built.joint_zero if self.machine.is_measured else 0.0
        return np.asarray(self._pose - zero)

    def _settle(self) -> None:
        forces = [
            LinkForce(number - 1, self._point_m(load), load.force_base_n)
            for number, load in self.loads.items()
        ]
        built = self._built
        command = self._motion.angle_rad
        if self.machine.is_measured:
            self._pose = command + built.joint_zero
            balance = built.statics.at(self._pose)
            frames = built.statics.links()
            wanted = balance.load + sum(
                (force_on(frames, force) for force in forces), np.zeros(len(self._pose))
            )
            reading = self._observer.balancing(balance.moment, wanted)
            channels = self.machine.channels
            is_tension = channels.tendon >= 0
            self._tensions_n[channels.tendon[is_tension]] = reading[is_tension]
            self._torques[channels.coordinate[~is_tension]] = reading[~is_tension]
            return
        unstretched_m = self._holding.unstretched_m(
            command, built.statics, built.pretension_n, built.joint_zero
        )
        try:
            self._pose, self._tensions_n = built.statics.rest(unstretched_m, forces, self._pose)
        except MachineError:
            self.refusals += 1

    def _point_m(self, load: Load) -> Array:
        middle_m = float(self.machine.links.touched_m[load.segment - 1].mean())
        return np.array([middle_m if load.contact_m is None else load.contact_m, 0.0, 0.0])
