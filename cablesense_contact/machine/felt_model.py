"""A machine that MuJoCo describes, as estimates see it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from cablesense_base import Array
from cablesense_contact.cable_slides import CableSlides, FrictionParameters
from cablesense_contact.felt import ChannelLimits, LinkFrameOffsets, LinksAtPose
from cablesense_contact.machine.felt_directions import felt_across
from cablesense_contact.machine.law import GRAPH_FORCE_N
from cablesense_contact.machine.observation import Observer
from cablesense_contact.machine.tendon_friction import CarriedTendonFriction
from cablesense_contact.machine.tendon_routes import TendonRoutes
from cablesense_contact.reference_contacts import ReferenceContacts, ReferenceLoads
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce, MachineStatics
from cablesense_sim.touch import is_one_place

_KNOWN_SHARE_OF_LARGEST = 1.0 / GRAPH_FORCE_N
"""A force is known if both ends of its interval are within this share of the largest one of it."""
_REFERENCE_SHARE = 0.2
"""Force of the contacts by which a machine is judged, as a share of the largest one."""
_LARGEST_COMMAND = 1e3
"""rad or m, that a command states: a number beyond is not meant."""
_SLACK_BELOW_STD = 4.0
"""An unloaded reading below this many deviations of a sensor's zero may be of a slack tendon."""


_FELT_OF_Z = 0.1
"""Felt share of a force along a link's z, below which a direction near its y is taken."""


class FeltModel:
    """A machine that MuJoCo describes as estimates see it: a `felt.FeltMachine`.

    Its frames are those of the model's bodies.

    Attributes:
        source: the machine.
    """

    def __init__(self, machine: Machine) -> None:
        self.source = machine
        self._statics = MachineStatics(machine)
        self._observer = Observer(machine)
        channels = machine.channels
        links = machine.links
        tolerances = machine.source.file.tolerances
        parameters = self._observer.parameters
        slices = parameters.slices
        self.parameters: MachineParameters = parameters
        self.name = machine.name
        self.identity = machine.identity
        self.command_names = machine.command_names
        self.reads_joints = machine.is_measured
        self.largest_command = _LARGEST_COMMAND
        self.per_radian = _per_radian(machine, self._statics)
        self.torque_names = machine.coordinates.names
        self.first_command = self._observer.command_of(machine.reference)
        self.link_names = links.names
        self.surface_friction = machine.source.file.touch.friction
        self.known_n = _KNOWN_SHARE_OF_LARGEST * machine.source.file.touch.largest_n
        self.drift_per_hour = tolerances.drift_per_hour
        self.contact_m: Sequence[float] = links.touched_m.mean(axis=1).tolist()
        self.middle_m: Array = links.touched_m.mean(axis=1)
        self.felt_across: Array = felt_across(self._observer)
        self.is_one_place = is_one_place(links.touched_m, links.radius_m)
        span_m = links.touched_m[:, 1] - links.touched_m[:, 0]
        self.joint_m: Array = np.cumsum(span_m) - links.touched_m[:, 1]
        self.channels = ChannelLimits(
            channels.names, channels.units, channels.lowest, channels.highest
        )
        self.link_frames = LinkFrameOffsets(links.axes, links.origin_m)
        self.zeros = np.zeros(len(channels.names), dtype=np.int64)
        numbers = np.arange(len(parameters))
        self.zeros[parameters.is_force] = numbers[slices["sensor_zero"]]
        self.zeros[~parameters.is_force] = numbers[slices["torque_zero"]]
        self.carried_friction = parameters.carried_friction
        zero_n = np.where(parameters.is_force, tolerances.zero_n, -np.inf)
        self.slack_below = _SLACK_BELOW_STD * np.hypot(zero_n, np.sqrt(channels.variance))
        self.slack_below[~parameters.is_force] = -np.inf

    @cached_property
    def slides(self) -> CableSlides:
        """How what friction carries follows from what moves the tendons."""
        routes = TendonRoutes(self.source, CarriedTendonFriction(self.source))
        return CableSlides(routes, FrictionParameters.of(self.parameters))

    def mean_variance(self, count: int) -> Array:
        """(M,) variance of the mean of some readings; rounding does not average out."""
        channels = self.source.channels
        return np.asarray(channels.noise_std**2 / count + channels.step**2 / 12.0)

    def innovation_noise(self, command: Array, variance: Array) -> Array:
        """(D, D) covariance of innovations of readings with variances (M,) at a command."""
        return self._observer.noise(command, variance)

    def unrest(self, speed_rad_s: Array, swing_rad_s2: Array) -> Array:
        """(n, n) covariance of the torques of inertia and damping, as large as they are."""
        if len(speed_rad_s) != len(self.torque_names):
            # actuators are commanded: how joints move is not known
            return np.zeros((len(self.torque_names),) * 2)
        return self._statics.unrest(speed_rad_s, swing_rad_s2)

    def frame_pose(self, command: Array, pose: Array) -> Array:
        """The commanded pose, or, where actuators are commanded, the one that was found."""
        return pose if self.source.source.file.joints == "actuators" else command

    def links_at(self, pose: Array) -> LinksAtPose:
        """The links at a pose (n,)."""
        self._statics.at(pose)
        frames = self._statics.links()
        turn = frames.axes.transpose(0, 2, 1)
        along = frames.axes[:, :, 0]
        slope = np.cross(frames.by_moment, along[:, :, None], axis=1)
        return LinksAtPose(frames.axes, frames.origin_m, turn @ frames.by_force_m, turn @ slope)

    def reference_contacts(self) -> ReferenceContacts:
        """Contacts across every link, in the reference pose.

        Raises:
            MachineError: it does not bear such a contact.
        """
        machine = self.source
        command = self.first_command
        parameters = self.parameters
        nominal = SimulatedMachine(machine, parameters, 0.0 * parameters.prior_mean)
        untouched = nominal.untouched(command)
        directions = np.array([_felt_direction(projection) for projection in self.felt_across])
        force_n = _REFERENCE_SHARE * machine.source.file.touch.largest_n
        count = len(machine.links.names)
        readings = []
        for n in range(count):
            contact = LinkForce(n, np.array([self.middle_m[n], 0.0, 0.0]), force_n * directions[n])
            readings.append(nominal.touched(command, [contact], untouched).values)
        loads = ReferenceLoads(
            force_n=force_n,
            reading=np.array(readings),
            command=np.tile(command, (count, 1)),
            link=np.arange(count),
            place_m=self.middle_m,
            direction=directions,
            touched_m=machine.links.touched_m,
        )
        return ReferenceContacts(loads, len(self.torque_names))


def _per_radian(machine: Machine, statics: MachineStatics) -> float:
    """By how much commands change where a joint turns: lengths, if actuators are commanded."""
    if machine.source.file.joints != "actuators":
        return 1.0
    tendons = machine.tendons
    drawn = tendons.drawn_by >= 0
    moment = statics.at(machine.reference).moment
    return float(np.abs(tendons.gear[drawn, None] * moment[drawn]).max())


def _felt_direction(projection: Array) -> Array:
    """(3,) the felt direction across a link that is nearest to its z, or else to its y.

    `projection` (2, 2) takes a force (y, z) across the link to the part of it that is felt.
    """
    across = projection[:, 1]
    if np.linalg.norm(across) < _FELT_OF_Z:
        across = projection[:, 0]
    return np.append(0.0, across / np.linalg.norm(across))
