"""The tendons of a machine that MuJoCo describes, as slides follow from them."""

from __future__ import annotations

import math

import numpy as np

from cablesense_base import Array
from cablesense_contact.cable_routes import MOVED_STD, OnTheWay
from cablesense_contact.machine.tendon_friction import CarriedTendonFriction
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.statics import MachineStatics

_RETURNING = 0.2
"""Chosen on the bundled finger, touched in the simulation of its friction: no derivation."""


class TendonRoutes:
    """A `cablesense_contact.cable_routes.CableRoutes` of the tendons that are read.

    Attributes:
        compliance_m_n, pretension_n, moved_n, are_followed, returning: see there. Where
            joints are measured, tensions are what drives give, and nothing is followed.
    """

    returning = _RETURNING

    def __init__(self, machine: Machine, friction: CarriedTendonFriction) -> None:
        channels = machine.channels
        tendons = machine.tendons
        is_tension = channels.tendon >= 0
        read = channels.tendon[is_tension]
        self._machine = machine
        self._guides = friction.guides
        self._statics = MachineStatics(machine)
        self._holding = Holding(machine)
        self.compliance_m_n = friction.compliance_share / tendons.stiffness_n_m[read, None]
        self.pretension_n = tendons.pretension_n[read]
        variance = channels.variance[is_tension]
        self.moved_n = MOVED_STD * math.sqrt(float(variance.max(initial=0.0)))
        self.are_followed = not machine.is_measured

    def on_the_way(self, from_command: Array, to_command: Array, steps: int) -> OnTheWay:
        """Pieces and guides on a straight way between commands (C,), in steps."""
        shares = np.linspace(0.0, 1.0, steps + 1)
        way = [from_command + share * (to_command - from_command) for share in shares]
        guides = [self._guides.at(self._pose(command)) for command in way]
        return OnTheWay(
            length_m=np.array([there.length_m for there in guides]),
            wrap_rad=np.array([there.wrap_rad for there in guides]),
        )

    def slope_m(self, command: Array) -> Array:
        """(M, G + 1, n) derivatives of the pieces' lengths by the coordinates at a command."""
        return self._guides.at(self._pose(command)).slope_m

    def wrap_rad(self, command: Array) -> Array:
        """(M, G) by which tendons turn at the guides at a command."""
        return self._guides.at(self._pose(command)).wrap_rad

    def _pose(self, command: Array) -> Array:
        """(n,) about where the machine is: as commanded, or where its actuators' lengths take it.

        Raises:
            MachineError: it finds no rest.
        """
        machine = self._machine
        if machine.source.file.joints == "commanded":
            return command
        pretension_n = machine.tendons.pretension_n
        nothing = np.zeros(len(machine.coordinates))
        unstretched_m = self._holding.unstretched_m(command, self._statics, pretension_n, nothing)
        return self._statics.rest(unstretched_m, (), machine.reference).pose
