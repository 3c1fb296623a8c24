"""A built machine that is commanded and touched, and what its sensors read of that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.machine.built_machine import BuiltMachine
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.statics import LinkForce, LinkFrames, force_on


class AtRest(NamedTuple):
    """A machine at rest.

    Attributes:
        pose: (n,) its coordinates.
        tensions_n: (K,) of its tendons.
        values: (M,) what its channels read without noise, step and range.
    """

    pose: Array
    tensions_n: Array
    values: Array


class SimulatedMachine:
    """One built machine; contacts are stated along the axes that links have at the command.

    Attributes:
        machine: as its file describes it.
        built: as it is.
    """

    def __init__(self, machine: Machine, parameters: MachineParameters, theta: Array) -> None:
        """`theta` (P,) are deviations; see `MachineParameters`."""
        self.machine = machine
        self.built = BuiltMachine(machine, parameters, theta)
        self._holding = Holding(machine)

    def untouched(self, command: Array) -> AtRest:
        """The machine at a command (C,), or at positions (n,) as its joints read them.

        Raises:
            MachineError: it finds no rest.
        """
        return self.under(command, (), None)

    def frames(self, command: Array, untouched: AtRest) -> LinkFrames:
        """The links, with the axes along which contacts are stated."""
        is_commanded = self.machine.source.file.joints == "commanded"
        self.built.statics.at(command if is_commanded else untouched.pose)
        return self.built.statics.links()

    def touched(self, command: Array, contacts: Sequence[LinkForce], untouched: AtRest) -> AtRest:
        """The machine under contacts whose forces are along the links' stated axes.

        Raises:
            MachineError: it finds no rest.
        """
        axes = self.frames(command, untouched).axes
        forces = [replace(one, force_n=axes[one.link] @ one.force_n) for one in contacts]
        return self.under(command, forces, untouched.pose)

    def unstretched_m(self, command: Array) -> Array:
        """(K,) unstretched lengths of the tendons that actuators hold at a command (C,)."""
        built = self.built
        return self._holding.unstretched_m(
            command, built.statics, built.pretension_n, built.joint_zero
        )

    def under(self, command: Array, forces: Sequence[LinkForce], near: Array | None) -> AtRest:
        """The machine under forces in base axes, searched for from a pose (n,) on.

        Raises:
            MachineError: it finds no rest.
        """
        if self.machine.is_measured:
            return self._in_pose(command, forces)
        built = self.built
        unstretched_m = self.unstretched_m(command)
        start = self.machine.reference if near is None else near
        if near is None and self.machine.source.file.joints == "commanded":
            start = command + built.joint_zero
        rest = built.statics.rest(unstretched_m, forces, start)
        values = rest.tensions_n[self.machine.channels.tendon]
        return AtRest(rest.pose, rest.tensions_n, built.gain * values + built.zero)

    def _in_pose(self, command: Array, forces: Sequence[LinkForce]) -> AtRest:
        """Drives hold the pose: what they must give is what their sensors read."""
        built = self.built
        machine = self.machine
        channels = machine.channels
        pose = command + built.joint_zero
        unstretched_m = self._holding.unstretched_m(
            machine.reference, built.statics, built.pretension_n, np.zeros_like(built.joint_zero)
        )
        balance = built.statics.at(pose)
        frames = built.statics.links()
        # springs have the tension of their length; what is read is drawn, from its pretension on
        tensions_n = built.statics.tensions_n(balance.length_m, unstretched_m)
        drawn = channels.tendon[channels.tendon >= 0]
        tensions_n[drawn] = built.pretension_n[drawn]
        contact = sum((force_on(frames, force) for force in forces), np.zeros(len(pose)))
        missing = balance.load + contact - tensions_n @ balance.moment
        driven = channels.coordinate >= 0
        held_by_tendons = np.ones(len(pose), dtype=bool)
        held_by_tendons[channels.coordinate[driven]] = False
        by_tension = balance.moment[drawn][:, held_by_tendons]
        tensions_n[drawn] += np.linalg.pinv(by_tension.T) @ missing[held_by_tendons]
        torque = tensions_n @ balance.moment - balance.load - contact
        values = np.empty(len(channels.names))
        values[~driven] = tensions_n[channels.tendon[~driven]]
        values[driven] = torque[channels.coordinate[driven]]
        return AtRest(pose, tensions_n, built.gain * values + built.zero)
