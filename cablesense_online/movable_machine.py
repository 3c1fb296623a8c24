"""A machine that MuJoCo describes, as a commissioning moves it."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_contact.calibration import Calibration
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_contact.reference_contacts import ReferenceContacts
from cablesense_online.movable import DIRECTIONS, TAUT_SHARE, outward
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import MachineStatics

_RANGE_SHARE = 0.95
"""Joints stay within this share of their range about its middle, away from their stops."""


class MovableMachine:
    """A machine that a commissioning moves: a `movable.Movable`; statics predict its readings.

    Hinges turn about the reference pose; slides stay where they are there.
    """

    def __init__(self, felt: FeltModel) -> None:
        """Of a machine whose joints or actuators are commanded.

        Raises:
            MachineError: its joints are measured, so nothing here commands them.
        """
        machine = felt.source
        if machine.is_measured:
            raise MachineError(
                f"machine {machine.name} has joints: measured, so no commands of it are known "
                "here; let its controller visit some twenty-five poses, record them, and give the "
                "recording to `cablesense calibrate`"
            )
        self.felt = felt
        self._machine = machine
        self._holding = Holding(machine)
        self._statics = MachineStatics(machine)
        tendons = machine.tendons
        self.taut_n: Array = TAUT_SHARE * tendons.pretension_n[machine.channels.tendon]
        cables = machine.source.file.cables
        states_friction = "friction_coefficient" in cables.model_fields_set
        self.rubs = states_friction and cables.friction_coefficient > 0.0
        self._drawn = np.flatnonzero(tendons.drawn_by >= 0)
        self._by_actuators = machine.source.file.joints == "actuators"
        self._moment = self._statics.at(machine.reference).moment.copy()
        by_pose = np.eye(len(machine.coordinates))
        if self._by_actuators:
            by_pose = tendons.gear[self._drawn, None] * self._moment[self._drawn]
        self._by_pose: Array = by_pose
        self.per_radian = felt.per_radian

    def candidates(self, count: int, reach_rad: float, rng: np.random.Generator) -> Array:
        """(K, C) the first command first; joints and controls stay within their ranges."""
        machine = self._machine
        is_hinge = machine.coordinates.is_hinge
        drawn = rng.uniform(-reach_rad, reach_rad, (count, len(is_hinge)))
        away = np.where(is_hinge, outward(drawn, reach_rad), 0.0)
        away[0] = 0.0
        low, high = self._range()
        poses = np.clip(machine.reference + away, low, high)
        commands = np.array([self._holding.command_of(pose) for pose in poses])
        return commands[self._within_controls(commands)]

    def predicted_n(self, commands: Array, calibration: Calibration) -> Array:
        """Readings (K, M) without a load at commands (K, C); zero where it finds no rest."""
        built = SimulatedMachine(self._machine, self.felt.parameters, calibration.mean)
        reading_n = np.zeros((len(commands), len(self.taut_n)))
        for row, command in enumerate(commands):
            try:
                reading_n[row] = built.untouched(command).values
            except MachineError:
                continue
        return reading_n

    def beside(self, approach_rad: float) -> Array:
        """(C,) by which every tendon is drawn."""
        machine = self._machine
        rng = np.random.default_rng(0)
        turns = rng.uniform(-1.0, 1.0, (DIRECTIONS, len(machine.coordinates)))
        turns *= machine.coordinates.is_hinge
        turns /= np.abs(turns).max(axis=1, keepdims=True)
        read = machine.channels.tendon
        least_m = np.abs(turns @ self._moment[read].T).min(axis=1)
        turn = approach_rad * turns[least_m.argmax()]
        return np.asarray(self._by_pose @ turn)

    def farthest_m(self, start: Array, commands: Array) -> float:
        """How far the end of any link moves, of the machine as its file describes it."""
        ends_m = np.array([self._ends_m(command) for command in (start, *commands)])
        return float(np.linalg.norm(ends_m[1:] - ends_m[0], axis=-1).max())

    def reference_contacts(self) -> ReferenceContacts:
        """Across every link, in the reference pose."""
        return self.felt.reference_contacts()

    def _range(self) -> tuple[Array, Array]:
        """(n,) lowest and highest positions of the coordinates, the reference among them."""
        machine = self._machine
        model = machine.model
        joints = machine.coordinates.joints
        limits = model.jnt_range[joints]
        middle = limits.mean(axis=1)
        half = _RANGE_SHARE * 0.5 * (limits[:, 1] - limits[:, 0])
        is_limited = model.jnt_limited[joints].astype(bool)
        low = np.where(is_limited, middle - half, -np.inf)
        high = np.where(is_limited, middle + half, np.inf)
        return np.minimum(low, machine.reference), np.maximum(high, machine.reference)

    def _within_controls(self, commands: Array) -> Array:
        """(K,) whether commands (K, C) are ones that the actuators take."""
        if not self._by_actuators:
            return np.ones(len(commands), dtype=bool)
        model = self._machine.model
        actuators = self._machine.tendons.drawn_by[self._drawn]
        is_limited = model.actuator_ctrllimited[actuators].astype(bool)
        low, high = model.actuator_ctrlrange[actuators].T
        inside = (commands >= low) & (commands <= high)
        return np.asarray((inside | ~is_limited).all(axis=1))

    def _ends_m(self, command: Array) -> Array:
        """(2N, 3) ends of the links at a command (C,)."""
        pose = command
        if self._by_actuators:
            exact = 0.0 * self.felt.parameters.prior_mean
            nominal = SimulatedMachine(self._machine, self.felt.parameters, exact)
            pose = nominal.untouched(command).pose
        self._statics.at(pose)
        frames = self._statics.links()
        along = frames.axes[:, :, 0]
        low_m, high_m = self._machine.links.touched_m.T
        first = frames.origin_m + low_m[:, None] * along
        last = frames.origin_m + high_m[:, None] * along
        return np.concatenate([first, last])
