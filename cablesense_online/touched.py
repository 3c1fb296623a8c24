"""A simulated machine that is touched once, and what the running estimator says: one instant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact, ForceState, Load
from cablesense_msgs_py.serialized import EffortWriter
from cablesense_online.answer import Answer
from cablesense_online.estimation import Estimation
from cablesense_online.models import Loaded
from cablesense_online.page.headline import headline
from cablesense_online.page.shown import ShownMachine
from cablesense_online.page.snapshot import (
    IN_CONTACT,
    ForceBounds,
    PlaceInterval,
    ShownStatus,
    Snapshot,
)
from cablesense_online.recorded_estimates import command_message
from cablesense_online.settings import EstimationSettings
from cablesense_online.simulation import Simulation

_SETTLED_S = 4.0
"""From a load until an arm has stopped swinging."""
_STEP_S = 0.05
"""From one reading to the next: an arm's simulation catches up with twice of it at once."""
_BEGIN_NS = 1_000_000_000
"""Stamp at time zero: 0 would be none."""


def touched_moment(
    shown: ShownMachine,
    loaded: Loaded,
    simulation: Simulation,
    settings: EstimationSettings,
    contact: Contact,
    rng: np.random.Generator,
) -> Snapshot:
    """The machine under a contact in its first pose, after one tare there, with the estimate.

    Raises:
        CableSenseError: the machine cannot be touched there, or does not bear it.
    """
    felt = shown.felt
    run = _Run(simulation, Estimation(felt, loaded.contacts(settings), settings, 0.0), rng)
    run.begin(felt.first_command, reads_joints=felt.reads_joints)
    run.wait(_SETTLED_S)
    run.answer_for(settings.tare_samples * _STEP_S)
    frame_pose = felt.frame_pose(felt.first_command, simulation.joint_positions)
    axes = shown.links_at(frame_pose).axes[contact.segment - 1]
    force_n = axes @ np.array(contact.wrench[:3])
    simulation.push(Load(contact.segment, force_n, contact.contact_m), run.now_s)
    answer = run.answer_for(_SETTLED_S)
    return _snapshot(shown, simulation.joint_positions, frame_pose, run.reading, contact, answer)


class _Run:
    """A simulation and an estimator of it, with their own clock.

    Attributes:
        now_s: time since the beginning.
        reading: (M,) the latest one.
    """

    def __init__(
        self, simulation: Simulation, estimation: Estimation, rng: np.random.Generator
    ) -> None:
        self._simulation = simulation
        self._estimation = estimation
        self._rng = rng
        self._writer = EffortWriter(simulation.channel_names)
        self._reads_joints = False
        self.now_s = 0.0
        self.reading: Array = np.zeros(len(simulation.channel_names))

    def begin(self, command: Array, *, reads_joints: bool) -> None:
        """The estimator learns the command (C,) in force, or from now on positions of joints."""
        self._reads_joints = reads_joints
        self._estimation.begin_at(command)
        self._command(self._simulation.command_names, command)

    def wait(self, seconds: float) -> None:
        """Nobody reads the sensors meanwhile."""
        for _ in range(round(seconds / _STEP_S)):
            self._step()

    def answer_for(self, seconds: float) -> Answer:
        """The last answer of so long a time."""
        answer = Answer()
        for _ in range(max(1, round(seconds / _STEP_S))):
            self._step()
            if self._reads_joints:
                simulation = self._simulation
                self._command(simulation.joint_names, simulation.joint_positions)
            self.reading = self._simulation.reading(self._rng)
            raw = self._writer.write(self._stamp_ns, self.reading.tolist())
            answer = self._estimation.sample(raw, self._stamp_ns, self._stamp_ns * 1e-9)
        return answer

    @property
    def _stamp_ns(self) -> int:
        return _BEGIN_NS + round(self.now_s * 1e9)

    def _command(self, names: Sequence[str], positions: Array) -> None:
        self._estimation.command(command_message(tuple(names), positions, self._stamp_ns))

    def _step(self) -> None:
        self.now_s += _STEP_S
        self._simulation.advance_to(self.now_s)


def _snapshot(
    shown: ShownMachine,
    pose: Array,
    frame_pose: Array,
    reading: Array,
    true: Contact,
    answer: Answer,
) -> Snapshot:
    stated = answer.contact
    in_contact = answer.force in IN_CONTACT and stated.segment > 0
    knows_force = in_contact and stated.magnitude_n > 0.0
    estimated = (stated,) if knows_force else ()
    moment = stated if in_contact and not knows_force else None
    bounds = _force_bounds(answer) if in_contact or answer.force is ForceState.HIDDEN else None
    region: tuple[PlaceInterval, ...] = ()
    if in_contact and answer.region_m is not None:
        region = shown.covered(stated.segment, *answer.region_m)
    sentence = headline(answer.force, estimated, bounds, moment, shown.words)
    return Snapshot(
        time_s=0.0,
        pose=pose,
        frame_pose=frame_pose,
        readings=reading,
        true=(true,),
        state=answer.force,
        estimated=estimated,
        bounds=bounds,
        probabilities=np.array(answer.probabilities) if answer.probabilities else None,
        status=ShownStatus(answer.force.level, sentence),
        known_by_moment=moment,
        region=region,
    )


def _force_bounds(answer: Answer) -> ForceBounds | None:
    if answer.bounds is None:
        return None
    lower, upper = answer.bounds
    angles_deg = (lower.angle_deg, upper.angle_deg) if lower.magnitude_n else None
    return ForceBounds(lower.magnitude_n, upper.magnitude_n, angles_deg)
