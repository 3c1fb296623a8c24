"""What one reading of a machine says, linear about a pose: an observation.

Two kinds of machines, one form. Where actuators hold tendons whose stiffness is known, readings y
are tensions, which follow from the pose:

    y = g T(r) + b + noise,   F(r) + τ = 0,   δT = D δτ + [A - D (B - J' A)] δθ,   D = -K J H⁻¹,

with τ the generalised forces of contacts, H = ∂F/∂r, J = ∂l/∂r, and A and B the derivatives of
tensions and forces by the parameters θ at a fixed pose (`sensitivity`). The pose is the one that
explains the reading by the least contacts: tensions fix the coordinates that they determine, and
of the others a wide prior of contact forces takes the least.

Where joint positions are read, the pose is known, and each coordinate has one equation:

    τ = J' T - F_0(r) - u,

with tensions T and torques u of the drives as read. That is an observation of τ itself.

In both, an observation x has the covariance S = R + G Σ G', as in `training/law/measurement`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, TypeVar

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_contact.machine.sensitivity import ParameterSources, Sensitivity
from cablesense_contact.machine.tendon_friction import CarriedTendonFriction
from cablesense_sim.machine.built_machine import BuiltMachine
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.statics import Balance, LinkForce, LinkFrames, MachineStatics

_Value = TypeVar("_Value")
_TAUT_ABOVE_STD = 4.0
"""A reading above this many deviations of the sensor's noise and zero shows a taut tendon."""
_POSE_STEPS = 12
"""At most, of the search for the pose behind a reading."""
_POSE_FOUND = 1e-6
"""It ends where a step is shorter, rad or m: an observation is linear about the pose, and what is
left is of second order."""
_NEW_DERIVATIVE_STEP = 1e-2
"""Steps longer than this, rad or m, lead to a pose whose derivative is taken anew."""
_LEAST_TORQUE_SHARE = 1e-3
"""Deviation of a coordinate's contact force that no touched link makes, over the largest."""
_REACH_STD = 3.0
"""Deviations of its zero within which a coordinate is taken to be, for what is not linear: the
other tolerances move it, too."""
_CROSS = np.zeros((9, 3))
"""(9, 3) of the matrices that take w to w x e, by e."""
_CROSS[[1, 5, 6], [2, 0, 1]] = 1.0
_CROSS[[2, 3, 7], [1, 2, 0]] = -1.0
_SAME_BENDS = 2e-3
"""A pose that is nearer, rad or m, bends tendons by the same angles."""
_COMMANDS_KEPT = 64
"""Commands and parameters for which what does not depend on the reading is kept."""


class Observation(NamedTuple):
    """What a reading says of a machine with N links, M channels, n coordinates, P parameters.

    Attributes:
        reading: (M,).
        innovation: (D,) the observation minus that of the untouched machine.
        information: (D, D) inverse covariance of innovations.
        by_torque: (D, n) derivative of observations by contact forces.
        by_parameter: (D, P) by the parameters.
        by_channel: (D, M) by what a channel reads too much.
        levers: (N, 6, n) generalised forces of unit forces at the origins of the links' axis
            frames, along the axes that these have at the command, and their slopes along the
            links' axes.
        torsion: (N, 1, n) of unit moments about the links' axes.
        pose: (n,).
        load_slope: (n, n) derivative of the machine's forces there, at constant tensions.
        is_slack: whether a tendon that is read may be slack, with too few others to fix the pose:
            a larger force reads the same.
    """

    reading: Array
    innovation: Array
    information: Array
    by_torque: Array
    by_parameter: Array
    by_channel: Array
    levers: Array
    torsion: Array
    pose: Array
    load_slope: Array
    is_slack: np.bool_


class OperatingPoint(NamedTuple):
    """Where an observation is to be linear.

    Attributes:
        pose: (n,).
        load_slope: (n, n) derivative of the forces there, at constant tensions; None if it is to
            be found out.
    """

    pose: Array
    load_slope: Array | None = None


class _Known(NamedTuple):
    """What does not depend on the reading.

    Attributes:
        built: the machine with the mean parameters.
        unstretched_m: (K,) lengths of its tendons at the command.
        pose: (n,) of the untouched machine.
        load_slope: (n, n) derivative of forces there at its tensions.
        sources: of the parameters, there.
        rows: (S, P) derivatives of these sources, and of the M gains and M zeros of channels.
        frames: of the links at the command.
        curvature: (n, n) what the linear law misses of the forces, if each coordinate in turn is
            off as far as its zero may be.
    """

    built: BuiltMachine
    unstretched_m: Array
    pose: Array
    load_slope: Array
    sources: ParameterSources
    rows: Array
    frames: LinkFrames
    curvature: Array


class _Spread(NamedTuple):
    """What a covariance of the parameters makes of the sources.

    Attributes:
        rows: (S, P) whose sources these are.
        covariance: (P, P) of the parameters.
        of_sources: (S, S).
        taut_above_n: (M,) tensions that show a taut tendon.
        channel_root: (M, M) a root L of the precision L L' of tensions of the untouched machine.
        force_root: (n, n) the same of the forces of contacts.
    """

    rows: Array
    covariance: Array
    of_sources: Array
    taut_above_n: Array
    channel_root: Array
    force_root: Array


class Observer:
    """Makes observations of the readings of one machine.

    Attributes:
        machine: the machine.
        parameters: what is uncertain about it.
        determines_pose: whether readings tell the pose of a machine that is touched.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        fewer_channels = len(machine.channels.names) < len(machine.coordinates)
        self.determines_pose = machine.is_measured or not fewer_channels
        self.parameters = MachineParameters(machine)
        self._holding = Holding(machine)
        self._variance = machine.channels.variance
        self._kept: dict[bytes, _Known] = {}
        self._kept_without_friction: dict[bytes, _Known] = {}
        self._built: dict[bytes, BuiltMachine] = {}
        self._last: _Spread | None = None
        self._friction_variance = _joint_friction_variance(machine)
        self._contact_covariance = self._prior_of_torques()
        self._equations = _known_equations(machine)
        self._friction = CarriedTendonFriction(machine) if self.parameters.rubs else None

    def observe(
        self,
        reading: Array,
        command: Array,
        mean: Array,
        covariance: Array,
        unrest: Array,
        operating_point: OperatingPoint | None = None,
    ) -> Observation:
        """The observation in a reading (M,) at a command (C,), or at measured joint positions.

        Args:
            reading: N, and N·m of hinges' torques.
            command: of the coordinates (rad, m), or of the actuators.
            mean: (P,) and
            covariance: (P, P) of the parameters.
            unrest: (n, n) covariance of forces by motion.
            operating_point: where to be linear; by default in the pose that explains the reading.
        """
        known = self._known(command, mean)
        moving = unrest + np.diag(self._friction_variance)
        if self.machine.is_measured:
            return self._of_pose(known, reading, command, covariance, moving)
        seen = self._of_tensions(known, reading, covariance, moving, operating_point)
        if self._friction is None or np.abs(seen.pose - known.pose).max() < _SAME_BENDS:
            return seen
        # tendons bend, and rub, as they do in the pose that the reading shows
        there = self._rubbing(command, mean, seen.pose)
        return self._of_tensions(there, reading, covariance, moving, operating_point)

    def command_of(self, pose: Array) -> Array:
        """(C,) the command that holds the machine, as modelled, near a pose (n,)."""
        return self._holding.command_of(pose)

    def noise(self, command: Array, variance: Array) -> Array:
        """(D, D) covariance of observations of readings with variances (M,) at a command."""
        known = self._known(command, self.parameters.prior_mean)
        balance = known.built.statics.at(known.pose)
        if not self.machine.is_measured:
            curved = self._torques_in_channels(known, balance) @ known.curvature.T
            return np.diag(variance) + curved @ curved.T
        by_channel = self._by_channel(balance.pull)[self._equations]
        return np.asarray((by_channel * variance) @ by_channel.T)

    def _torques_in_channels(self, known: _Known, balance: Balance) -> Array:
        """(M, n) derivative of the readings of the untouched machine by contact forces."""
        statics = known.built.statics
        tensions_n = statics.tensions_n(balance.length_m, known.unstretched_m)
        slope = known.load_slope + statics.elastic_slope(balance.moment, tensions_n)
        by_torque = self._by_torque(balance.moment, tensions_n, slope, statics)
        return np.asarray(known.built.gain[:, None] * by_torque[self.machine.channels.tendon])

    def untouched_pose(self, command: Array, mean: Array) -> Array:
        """(n,) where nothing touches the machine."""
        return self._known(command, mean).pose

    def pose_under(
        self, contact: LinkForce, command: Array, mean: Array, near: Observation
    ) -> Array:
        """(n,) the machine at rest under a contact, whose force is in the link's stated axes.

        It is sought from the pose of another observation on.

        Raises:
            MachineError: it finds no rest.
        """
        known = self._known(command, mean)
        in_base = known.frames.axes[contact.link] @ contact.force_n
        force = replace(contact, force_n=in_base)
        statics = known.built.statics
        return statics.rest(known.unstretched_m, (force,), near.pose, near.load_slope).pose

    def _known(self, command: Array, mean: Array) -> _Known:
        key = mean.tobytes() + command.tobytes()
        if key not in self._kept:
            known = self._rubbing(command, mean, None)
            _keep(self._kept, key, known)
        return self._kept[key]

    def _without_friction(self, command: Array, mean: Array) -> _Known:
        key = mean.tobytes() + command.tobytes()
        if key in self._kept_without_friction:
            return self._kept_without_friction[key]
        built = self._built_of(mean)
        machine = self.machine
        statics = built.statics
        if machine.is_measured:
            pose = command + built.joint_zero
            unstretched_m = self._holding.unstretched_m(
                machine.reference, statics, built.pretension_n, np.zeros_like(built.joint_zero)
            )
            load_slope = np.zeros((len(pose), len(pose)))
        else:
            unstretched_m = self._holding.unstretched_m(
                command, statics, built.pretension_n, built.joint_zero
            )
            start = machine.reference
            if machine.source.file.joints == "commanded":
                start = command + built.joint_zero
            rest = statics.rest(unstretched_m, (), start)
            pose = rest.pose
            load_slope = statics.load_slope(pose, rest.tensions_n)
        sources = ParameterSources(machine, self.parameters, built, command, pose)
        rows = np.concatenate([sources.rows, self._channel_rows()])
        frame_pose = command if machine.source.file.joints == "commanded" else pose
        statics.at(frame_pose)
        frames = statics.links()
        curvature = np.zeros((len(pose), len(pose)))
        if not machine.is_measured:
            curvature = self._curvature(statics, pose, rest.tensions_n)
        known = _Known(built, unstretched_m, pose, load_slope, sources, rows, frames, curvature)
        _keep(self._kept_without_friction, key, known)
        return known

    def _curvature(self, statics: MachineStatics, pose: Array, tensions_n: Array) -> Array:
        """(n, n) b_i = (F(r + s_i) + F(r - s_i)) / 2 - F(r) at constant tensions, rows by i.

        Where a tendon comes to a pulley or leaves it, forces have a kink: with the true pose on
        its other side, they are off by as much. A smooth machine has next to none.
        """
        parameters = self.parameters
        is_hinge = self.machine.coordinates.is_hinge
        reach = np.empty(len(pose))
        reach[is_hinge] = parameters.prior_std[parameters.slices["joint_zero"]]
        reach[~is_hinge] = parameters.prior_std[parameters.slices["slide_zero"]]

        def forces(at: Array) -> Array:
            balance = statics.at(at)
            return np.asarray(balance.load - tensions_n @ balance.pull)

        here = forces(pose)
        steps = _REACH_STD * np.diag(reach)
        return np.array([0.5 * (forces(pose + s) + forces(pose - s)) - here for s in steps])

    def _rubbing(self, command: Array, mean: Array, pose: Array | None) -> _Known:
        """With friction as tendons bend at a pose (n,), or at that of the untouched machine."""
        part = self.parameters.carried_friction
        without = mean.copy()
        without[part] = 0.0
        known = self._without_friction(command, without)
        if self._friction is None:
            return known
        carried = self._friction.at(known.pose if pose is None else pose, mean[part])
        built = known.built.rubbing(carried.beside_m, carried.stretch)
        sources = known.sources.rubbing(built, carried)
        rows = np.concatenate([sources.rows, known.rows[len(sources.rows) :]])
        rubbing = known._replace(built=built, sources=sources, rows=rows)
        if self.machine.is_measured:
            return rubbing
        rest = built.statics.rest(known.unstretched_m, (), known.pose)
        load_slope = built.statics.load_slope(rest.pose, rest.tensions_n)
        return rubbing._replace(pose=rest.pose, load_slope=load_slope)

    def _built_of(self, mean: Array) -> BuiltMachine:
        key = mean.tobytes()
        if key not in self._built:
            _keep(self._built, key, BuiltMachine(self.machine, self.parameters, mean))
        return self._built[key]

    def _of_tensions(
        self,
        known: _Known,
        reading: Array,
        covariance: Array,
        moving: Array,
        operating_point: OperatingPoint | None,
    ) -> Observation:
        built = known.built
        statics = built.statics
        read = self.machine.channels.tendon
        tension = (reading - built.zero) / built.gain
        if operating_point is None:
            operating_point = OperatingPoint(self._pose_of(known, tension, covariance))
        pose = operating_point.pose
        load_slope = known.load_slope
        if operating_point.load_slope is not None:
            load_slope = operating_point.load_slope
        elif len(read) < len(pose):
            # where tensions do not determine the pose, how forces depend on it matters
            balance = statics.at(pose)
            tensions_n = statics.tensions_n(balance.length_m, known.unstretched_m)
            load_slope = statics.load_slope(pose, tensions_n)
        balance = statics.at(pose)
        frames = statics.links()
        tensions_n = statics.tensions_n(balance.length_m, known.unstretched_m)
        residual = balance.load - tensions_n @ balance.pull
        slope = load_slope + statics.elastic_slope(balance.moment, tensions_n)
        by_torque = self._by_torque(balance.moment, tensions_n, slope, statics)
        entering = known.sources.entering(tensions_n, pose)
        of_tensions = _at_rest(entering, by_torque, balance.pull)
        of_sources = self._of_channels(of_tensions[read], built.gain, tensions_n[read])
        by_torque = built.gain[:, None] * by_torque[read]
        spread = of_sources @ self._spread(known, covariance).of_sources @ of_sources.T
        spread += np.diag(self._variance) + by_torque @ moving @ by_torque.T
        curved = by_torque @ known.curvature.T
        spread += curved @ curved.T
        expected = built.gain * tensions_n[read] + built.zero
        is_taut = tension > self._spread(known, covariance).taut_above_n
        levers, torsion = _levers(frames, known.frames.axes)
        return Observation(
            reading=reading,
            innovation=reading - expected - by_torque @ residual,
            information=np.asarray(np.linalg.inv(spread)),
            by_torque=by_torque,
            by_parameter=of_sources @ known.rows,
            by_channel=np.eye(len(read)),
            levers=levers,
            torsion=torsion,
            pose=pose,
            load_slope=load_slope,
            is_slack=np.bool_(is_taut.sum() < min(len(is_taut), len(pose))),
        )

    def _pose_of(self, known: _Known, tension: Array, covariance: Array) -> Array:
        """(n,) the pose in which the mean machine has tensions (M,), by the least contacts.

        Its tensions need not agree better than those of the untouched machine are known.
        """
        statics = known.built.statics
        unstretched_m = known.unstretched_m
        read = self.machine.channels.tendon
        spread = self._spread(known, covariance)
        taut = tension > spread.taut_above_n
        of_channels = spread.channel_root.T
        of_forces = spread.force_root.T
        load_slope = known.load_slope
        pose = known.pose
        last = np.inf
        for _ in range(_POSE_STEPS):
            balance = statics.at(pose)
            elastic = statics.stiffness_n_m * (balance.length_m - unstretched_m)
            tensions_n = np.maximum(elastic, 0.0)
            modelled = np.where(taut, elastic[read], tensions_n[read])
            off = tension - modelled
            pulls = taut | (tensions_n[read] > 0.0)
            by_pose = (statics.stiffness_n_m[:, None] * balance.moment)[read]
            residual = balance.load - tensions_n @ balance.pull
            slope = load_slope + statics.elastic_slope(balance.moment, tensions_n)
            matrix = np.concatenate([of_channels @ (by_pose * pulls[:, None]), of_forces @ slope])
            wanted = np.concatenate([of_channels @ off, -(of_forces @ residual)])
            step = np.linalg.solve(matrix.T @ matrix, matrix.T @ wanted)
            pose = pose + step
            length = float(np.abs(step).max())
            if length < _POSE_FOUND:
                break
            if length > _NEW_DERIVATIVE_STEP or length > 0.1 * last:
                load_slope = statics.load_slope(pose, tensions_n)
            last = length
        return pose

    def _by_torque(
        self, moment: Array, tensions_n: Array, slope: Array, statics: MachineStatics
    ) -> Array:
        """(K, n) D = ∂T/∂τ = -K J H⁻¹ with moments (K, n) and H the slope (n, n)."""
        stiffened = (statics.stiffness_n_m * (tensions_n > 0.0))[:, None] * moment
        return np.asarray(-stiffened @ np.linalg.inv(slope))

    def _channel_rows(self) -> Array:
        """(2M, P) gains and zeros of channels by the parameters."""
        slices = self.parameters.slices
        is_force = self.parameters.is_force
        channels = len(self._variance)
        gains = np.zeros((channels, len(self.parameters)))
        zeros = np.zeros((channels, len(self.parameters)))
        gains[:, slices["sensor_gain"]] = np.eye(channels)
        zeros[is_force, slices["sensor_zero"]] = np.eye(int(is_force.sum()))
        zeros[~is_force, slices["torque_zero"]] = np.eye(int((~is_force).sum()))
        return np.concatenate([gains, zeros])

    def _of_channels(self, of_values: Array, gain: Array, values: Array) -> Array:
        """(M, S) readings by all sources, by those of values (M,) and by gains and zeros."""
        return np.concatenate(
            [gain[:, None] * of_values, np.diag(values), np.eye(len(values))], axis=1
        )

    def _spread(self, known: _Known, covariance: Array) -> _Spread:
        """What a covariance, which nobody changes in place, makes of the sources."""
        last = self._last
        if last is not None and last.rows is known.rows and last.covariance is covariance:
            return last
        of_sources = known.rows @ covariance @ known.rows.T
        read = self.machine.channels.tendon
        gain = known.built.gain
        statics = known.built.statics
        balance = statics.at(known.pose)
        tensions_n = statics.tensions_n(balance.length_m, known.unstretched_m)
        slope = known.load_slope + statics.elastic_slope(balance.moment, tensions_n)
        by_torque = self._by_torque(balance.moment, tensions_n, slope, statics)
        entering = known.sources.entering(tensions_n, known.pose)
        of_tensions = _at_rest(entering, by_torque, balance.pull)
        in_channels = self._of_channels(of_tensions[read], gain, tensions_n[read])
        of_readings = in_channels @ of_sources @ in_channels.T + np.diag(self._variance)
        zero_variance = np.diagonal(of_sources)[-len(read) :]
        self._last = _Spread(
            known.rows,
            covariance,
            of_sources,
            taut_above_n=_TAUT_ABOVE_STD * np.sqrt(self._variance + zero_variance) / gain,
            channel_root=np.linalg.cholesky(np.linalg.inv(of_readings / np.outer(gain, gain))),
            force_root=np.linalg.cholesky(np.linalg.inv(self._contact_covariance)),
        )
        return self._last

    def _of_pose(
        self, known: _Known, reading: Array, command: Array, covariance: Array, moving: Array
    ) -> Observation:
        built = known.built
        statics = built.statics
        channels = self.machine.channels
        rows = self._equations
        pose = known.pose
        balance = statics.at(pose)
        frames = statics.links()
        spring_n = statics.tensions_n(balance.length_m, known.unstretched_m)
        value = (reading - built.zero) / built.gain
        tensions_n = spring_n.copy()
        is_tension = channels.tendon >= 0
        tensions_n[channels.tendon[is_tension]] = value[is_tension]
        by_channel = self._by_channel(balance.pull)
        drives = np.flatnonzero(~is_tension)
        driven = np.zeros(len(pose))
        driven[channels.coordinate[drives]] = value[drives]
        # τ = J' T - F_0 - u
        innovation = tensions_n @ balance.pull - balance.load - driven
        slope = statics.load_slope(pose, tensions_n)
        entering = known.sources.entering(tensions_n, pose)
        # what is read does not follow from lengths, but springs' tensions do
        of_tensions = entering.of_tensions
        of_tensions[channels.tendon[is_tension]] = 0.0
        of_values = entering.of_forces - balance.pull.T @ of_tensions
        of_sources = np.concatenate([of_values, by_channel * value, by_channel], axis=1)
        by_parameter = of_sources @ known.rows
        slices = self.parameters.slices
        is_hinge = self.machine.coordinates.is_hinge
        by_parameter[:, slices["joint_zero"]] += slope[:, is_hinge]
        by_parameter[:, slices["slide_zero"]] += slope[:, ~is_hinge]
        tolerances = self.machine.source.file.tolerances
        read_std = np.where(
            is_hinge, np.deg2rad(tolerances.joint_noise_deg), tolerances.joint_noise_m
        )
        by_channel = by_channel / built.gain
        spread = by_parameter @ covariance @ by_parameter.T + moving
        spread += (by_channel * self._variance) @ by_channel.T + (slope * read_std**2) @ slope.T
        levers, torsion = _levers(frames, known.frames.axes)
        information = np.linalg.inv(spread[np.ix_(rows, rows)])
        return Observation(
            reading=reading,
            innovation=innovation[rows],
            information=information,
            by_torque=np.eye(len(pose))[rows],
            by_parameter=by_parameter[rows],
            by_channel=by_channel[rows],
            levers=levers,
            torsion=torsion,
            pose=pose,
            load_slope=slope,
            is_slack=np.False_,
        )

    def _by_channel(self, moment: Array) -> Array:
        """(n, M) how contact forces follow from what is read, with measured joints."""
        channels = self.machine.channels
        by_channel = np.zeros((moment.shape[1], len(channels.names)))
        is_tension = channels.tendon >= 0
        by_channel[:, is_tension] = moment[channels.tendon[is_tension]].T
        drives = np.flatnonzero(~is_tension)
        by_channel[channels.coordinate[drives], drives] = -1.0
        return by_channel

    def _prior_of_torques(self) -> Array:
        """(n, n) covariance of contact forces on the coordinates, as wide as any contact."""
        machine = self.machine
        statics = self._built_of(self.parameters.prior_mean).statics
        statics.at(machine.reference)
        levers, _ = _levers(statics.links(), None)
        middle_m = machine.links.touched_m.mean(axis=1)[:, None, None]
        unit = levers[:, :3] + middle_m * levers[:, 3:]
        covariance = np.einsum("nxi,nxj->ij", unit, unit) * machine.source.file.touch.largest_n**2
        floor = _LEAST_TORQUE_SHARE**2 * float(np.diagonal(covariance).max())
        return np.asarray(covariance + floor * np.eye(len(covariance)))


def _keep(kept: dict[bytes, _Value], key: bytes, value: _Value) -> None:
    """Keep a value, in place of the oldest if there are too many."""
    if len(kept) >= _COMMANDS_KEPT:
        kept.pop(next(iter(kept)))
    kept[key] = value


def _at_rest(entering: Sensitivity, by_torque: Array, pull: Array) -> Array:
    """(K, S) δT = (1 - D J') A + D B by the sources: see the head of this file."""
    kept = entering.of_tensions - by_torque @ (pull.T @ entering.of_tensions)
    return np.asarray(kept + by_torque @ entering.of_forces)


def _levers(frames: LinkFrames, axes: Array | None) -> tuple[Array, Array]:
    """Levers (N, 6, n) along given axes (N, 3, 3), or the links' own, and torsions (N, 1, n)."""
    along = frames.axes if axes is None else axes
    # a force f at s e from the frame adds the moment s e x f: f · (w x e) for each joint axis w
    place = frames.axes[:, :, 0]
    slope = (place @ _CROSS.T).reshape(-1, 3, 3) @ frames.by_moment
    turn = along.transpose(0, 2, 1)
    levers = np.concatenate([turn @ frames.by_force_m, turn @ slope], axis=1)
    torsion = place[:, None] @ frames.by_moment
    return levers, torsion


def _joint_friction_variance(machine: Machine) -> Array:
    """(n,) of the dry friction in joints, which is anywhere up to what the model states."""
    coordinates = machine.coordinates
    slope = coordinates.slope(coordinates.positions(machine.reference))
    bound = np.abs(slope).T @ machine.model.dof_frictionloss
    return np.asarray(bound**2 / 3.0)


def _known_equations(machine: Machine) -> Array:
    """Numbers of the coordinates all of whose forces are read or modelled."""
    model = machine.model
    joints = machine.coordinates.joints
    read = set(machine.channels.coordinate.tolist())
    driven = {
        int(model.actuator_trnid[a, 0])
        for a in range(model.nactuator)
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT
    }
    return np.array(
        [i for i, j in enumerate(joints.tolist()) if i in read or j not in driven], dtype=np.int64
    )
