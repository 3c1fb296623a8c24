"""A machine that differs from its model by given deviations of its parameters."""

from __future__ import annotations

import copy

import numpy as np

from cablesense_base import Array
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.statics import MachineStatics


class BuiltMachine:
    """The statics, and the numbers of tendons and sensors, of one machine.

    Attributes:
        statics: with the model that the deviations make.
        pretension_n: (K,) of the tendons at the reference pose.
        gain, zero: (M,) of the channels.
        stretch: (K,) of a tendon by its tension at the actuator, over that without friction.
        joint_zero: (n,) of the commands or the readings of joints.
    """

    def __init__(self, machine: Machine, parameters: MachineParameters, theta: Array) -> None:
        """`theta` (P,) are deviations, see `MachineParameters`; what friction carries is left."""
        slices = parameters.slices
        model = copy.copy(machine.model)
        bodies = parameters.bodies
        model.body_mass[bodies] *= 1.0 + theta[slices["mass"]]
        model.body_ipos[bodies] += theta[slices["centre_of_mass"]].reshape(3, -1).T
        springs = parameters.springs
        of_all_joints = float(theta[slices["common_joint_stiffness"]].sum())
        model.jnt_stiffness[springs] *= 1.0 + theta[slices["joint_stiffness"]] + of_all_joints
        routing = parameters.routing
        displaced = theta[slices["routing"]].reshape(2, -1)
        model.site_pos[routing.ids] += np.einsum("ws,swx->sx", displaced, routing.across)
        about_x, about_y = theta[slices["base_tilt"]]
        gravity = machine.model.opt.gravity
        model.opt.gravity[:] = gravity + np.cross([about_x, about_y, 0.0], gravity)
        stiffness = machine.tendons.stiffness_n_m * np.exp(theta[slices["tendon_stiffness"]])
        self.statics = MachineStatics(machine, model, stiffness)
        self.pretension_n = machine.tendons.pretension_n + theta[slices["pretension"]]
        self.stretch = np.ones(len(stiffness))
        self.gain = 1.0 + theta[slices["sensor_gain"]]
        self.zero = np.zeros(len(self.gain))
        self.zero[parameters.is_force] = theta[slices["sensor_zero"]]
        self.zero[~parameters.is_force] = theta[slices["torque_zero"]]
        is_hinge = machine.coordinates.is_hinge
        self.joint_zero = np.zeros(len(is_hinge))
        self.joint_zero[is_hinge] = theta[slices["joint_zero"]]
        self.joint_zero[~is_hinge] = theta[slices["slide_zero"]]

    def rubbing(self, beside_m: Array, stretch: Array) -> BuiltMachine:
        """The same with friction of its tendons; see `MachineStatics.rubbing`."""
        rubbing = copy.copy(self)
        rubbing.statics = self.statics.rubbing(beside_m, stretch)
        rubbing.stretch = stretch
        return rubbing
