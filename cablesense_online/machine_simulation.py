"""The simulation of a machine that MuJoCo describes: at rest at each reading, under its loads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_msgs_py.messages import Level, Load, read_load
from cablesense_msgs_py.topics import Frames
from cablesense_online.acting_loads import ActingLoads
from cablesense_online.placed_links import PlacedLinks, contact_frames
from cablesense_online.simulation import SimulationHealth, SimulationSettings
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.loads import LoadError
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.quasi_static import QuasiStaticMachine
from cablesense_sim.machine.simulated import AtRest, SimulatedMachine
from cablesense_sim.machine.statics import LinkForce

_RATE_HZ = 100.0
"""Of the readings: a machine file states none."""


class MachineSimulation:
    """A machine that MuJoCo describes, simulated: a `simulation.Simulation`.

    Attributes:
        machine: the machine.
        refusals: how often it found no rest, and stayed where it was.
    """

    joint_states_hz = np.inf
    urdf = None

    def __init__(self, machine: Machine, settings: SimulationSettings, now_s: float) -> None:
        self.machine = machine
        self.refusals = 0
        self._felt = FeltModel(machine)
        self._placed = PlacedLinks(self._felt.link_frames)
        self.identity = machine.identity
        self.channel_names: Sequence[str] = machine.channels.names
        self.command_names: Sequence[str] = machine.command_names
        self.joint_names: Sequence[str] = machine.coordinates.names
        self.largest_command = self._felt.largest_command
        self.rate_hz = settings.rate_hz or _RATE_HZ
        self._acting = ActingLoads(settings.load_timeout_s)
        parameters = MachineParameters(machine)
        theta = np.zeros(len(parameters))
        if settings.built_seed >= 0:
            theta = parameters.drawn(np.random.default_rng(settings.built_seed))
        self._simulated = SimulatedMachine(machine, parameters, theta)
        start = self._felt.first_command
        self._motion = JointMotion.at_rest(start, settings.joint_speed_rad_s)
        self._rest = self._simulated.untouched(start)
        self._rubbing: QuasiStaticMachine | None = None
        coefficient = abs(float(theta[parameters.slices["friction"]][0]))
        if coefficient > 0.0 and not machine.is_measured:
            self._rubbing = QuasiStaticMachine(self._simulated, start, coefficient)
        self._now_s = now_s

    @property
    def target(self) -> Array:
        """(C,) the last command."""
        return self._motion.target_rad

    @property
    def loads(self) -> Sequence[Load]:
        """Those that act."""
        return self._acting.loads

    @property
    def joint_positions(self) -> Array:
        """(n,) of the joints, as encoders read them."""
        if self.machine.is_measured:
            return self._motion.angle_rad
        return self._rest.pose

    def frames(self, prefix: str) -> Frames:
        """Those of the model's bodies."""
        return contact_frames(self._felt, prefix)

    def go_to(self, command: Array) -> None:
        """Begin to move to a command (C,)."""
        self._motion = self._motion.towards(command)

    def offset(self, lengths_m: Array) -> None:
        """Refused.

        Raises:
            MachineError: always: a breath is for arms of arm files.
        """
        raise MachineError(f"{self.machine.name}: offsets of cables are for arms of arm files")

    def read_load(self, message: Any, frames: Frames) -> Load:
        """The load of a message in a link's message frame, at the present pose.

        Raises:
            CableSenseError: see `messages.read_load` and `PlacedLinks.load_place_m`.
        """
        links = self._felt.links_at(self._rest.pose)

        def place_of(link: int, force_n: Array, torque_n_m: Array) -> float:
            return self._placed.load_place_m(link, links, force_n, torque_n_m)

        return read_load(message, frames, place_of=place_of)

    def push(self, load: Load, now_s: float) -> None:
        """Replace the load on a link; a zero force removes it.

        A place at most its radius beyond the end of a link counts as its end: where it is told by
        a torque, the link has moved since.

        Raises:
            LoadError: the place is not on the link.
        """
        n = load.segment - 1
        links = self.machine.links
        first_m, last_m = links.touched_m[n].tolist()
        beyond_m = float(links.radius_m[n])
        place_m = load.contact_m
        if place_m is not None:
            if not first_m - beyond_m <= place_m <= last_m + beyond_m:
                raise LoadError(
                    f"{place_m:.4f} m is not on {links.names[n]}, which is touched from "
                    f"{first_m:.4f} to {last_m:.4f} m along its axis"
                )
            place_m = min(max(place_m, first_m), last_m)
        self._acting.put(Load(load.segment, load.force_base_n, place_m), now_s)

    def advance_to(self, now_s: float) -> None:
        """Move on to a time, and come to rest there."""
        if self._motion.moving:
            self._motion = self._motion.after(now_s - self._now_s)
        self._now_s = now_s
        self._acting.ended(now_s)
        forces = [
            LinkForce(load.segment - 1, self._point_m(load), load.force_base_n)
            for load in self.loads
        ]
        try:
            self._rest = self._at_rest(forces)
        except MachineError:
            self.refusals += 1

    def _at_rest(self, forces: Sequence[LinkForce]) -> AtRest:
        """Tendons of a built machine rub, unless its file states a coefficient of zero."""
        command = self._motion.angle_rad
        if self._rubbing is not None:
            return self._rubbing.under(command, forces)
        return self._simulated.under(command, forces, self._rest.pose)

    def reading(self, rng: np.random.Generator | None) -> Array:
        """(M,) what the sensors read; without noise and step without `rng`."""
        return self.machine.channels.read(self._rest.values, rng)

    def health(self, now_s: float) -> SimulationHealth:
        """Whether it has found a rest whenever it was asked for one."""
        del now_s
        level = Level.WARN if self.refusals else Level.OK
        message = "the forces are more than it can bear" if self.refusals else "at rest"
        self.refusals = 0
        return SimulationHealth(level, message, {})

    def _point_m(self, load: Load) -> Array:
        middle_m = float(self.machine.links.touched_m[load.segment - 1].mean())
        return np.array([middle_m if load.contact_m is None else load.contact_m, 0.0, 0.0])
