"""Which lengths a machine's actuators hold at a command."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.statics import MachineStatics


class Holding:
    """Unstretched lengths of the tendons of a machine, by commands.

    Joints are commanded by the model: a tendon's actuator holds the length that the model has at
    the commanded pose, less what pretension stretches it by. The built machine was pretensioned in
    the reference pose, with the lengths that its own tendons have there.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._statics = MachineStatics(machine)
        self._by_actuators = machine.source.file.joints == "actuators"
        self._at_reference_m = self._statics.at(machine.reference).length_m.copy()

    def unstretched_m(
        self, command: Array, built: MachineStatics, pretension_n: Array, zeros: Array
    ) -> Array:
        """(K,) of a built machine with pretensions (K,) and joint zeros (n,) at a command (C,)."""
        tendons = self._machine.tendons
        given_m = pretension_n / built.stiffness_n_m
        if self._by_actuators:
            # a position servo pulls with kp (u - g l), so its tendon is slack at l = u / g
            drawn = np.flatnonzero(tendons.drawn_by >= 0)
            held_m = self._at_reference_m.copy()
            slack_m = tendons.pretension_n / tendons.stiffness_n_m
            held_m[drawn] = command / tendons.gear[drawn] + slack_m[drawn]
        else:
            held_m = self._statics.at(command + zeros).length_m
        built_m = built.at(self._machine.reference).length_m
        return np.asarray(held_m + (built_m - self._at_reference_m) - given_m)

    def command_of(self, pose: Array) -> Array:
        """(C,) the command that holds a machine, as modelled, near a pose (n,)."""
        if not self._by_actuators:
            return pose.copy()
        tendons = self._machine.tendons
        drawn = np.flatnonzero(tendons.drawn_by >= 0)
        slack_m = self._statics.at(pose).length_m - tendons.pretension_n / tendons.stiffness_n_m
        return np.asarray(tendons.gear[drawn] * slack_m[drawn])
