"""The law of a machine: observations by MuJoCo's statics, and the statement of a graph on them.

It answers as the law of an arm does (`cablesense_contact.law`), with links for segments, D
observations for M innovations, and n coordinates for 2N joint angles.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from cablesense_base import Array
from cablesense_contact.law import LawOutput
from cablesense_contact.machine.observation import Observation, Observer
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.statics import LinkForce

GRAPH_FORCE_N = 200.0
"""Largest lateral force that the statement's constants are made for; forces are scaled to it."""

EVIDENCE = (
    "reading_n",
    "channel_pull",
    "channel_information",
    "informed",
    "torque_precision",
    "torque_pull",
    "untouched_chi2",
    "levers",
    "by_torsion",
)
"""Inputs of the graph in a machine's model file, see `cablesense_training.law.evidence`."""

STATED = LawOutput._fields[: LawOutput._fields.index("fault_n") + 1]
"""Outputs of that graph."""

_OF_FORCE = ("force_n", "magnitude_ci95_n", "moment_n_m", "moment_std_n_m", "fault_n")
"""Outputs that scale with force."""


class Stater(Protocol):
    """States what evidence says: the graph in a model file, or its original."""

    def __call__(self, evidence: Mapping[str, Array]) -> Mapping[str, Any]:
        """`STATED` by `EVIDENCE`."""
        ...


class _Linear(NamedTuple):
    """An observation with its statement."""

    observation: Observation
    stated: Mapping[str, Array]


class MachineLaw:
    """The law of one machine; a `cablesense_contact.law.Law`.

    Attributes:
        machine: the machine.
        observer: makes observations of its readings.
    """

    def __init__(self, machine: Machine, state: Stater) -> None:
        self.machine = machine
        self.observer = Observer(machine)
        self._state = state
        self._largest_n = machine.source.file.touch.largest_n
        self._per_newton = GRAPH_FORCE_N / self._largest_n

    def __call__(
        self,
        reading_n: Array,
        command_rad: Array,
        mean: Array,
        covariance: Array,
        unrest_n2_m2: Array,
    ) -> LawOutput:
        """See `Law`; commands are (B, C), or measured positions (B, n)."""
        rows = [
            self._row(reading, command, mean, covariance, unrest_n2_m2)
            for reading, command in zip(reading_n, command_rad, strict=True)
        ]
        return LawOutput._make(np.concatenate(column) for column in zip(*rows, strict=True))

    def _row(
        self, reading: Array, command: Array, mean: Array, covariance: Array, unrest: Array
    ) -> LawOutput:
        observation = self.observer.observe(reading, command, mean, covariance, unrest)
        answer = _Linear(observation, self._stated(observation))
        if self._gives_way(observation):
            answer = self._about_the_contact(answer, command, mean, covariance, unrest)
        seen, stated = answer
        return LawOutput(
            **stated,
            innovation_n=seen.innovation[None],
            information_n2=seen.information[None],
            by_parameter=seen.by_parameter[None],
            by_torque=seen.by_torque[None],
            at_joint_m=seen.levers[None, :, :3],
            by_place=seen.levers[None, :, 3:],
            pose_rad=seen.pose[None],
        )

    def _gives_way(self, seen: Observation) -> bool:
        """Whether the pose under a contact is not determined by the readings alone."""
        return not self.machine.is_measured and len(seen.innovation) < len(seen.pose)

    def _about_the_contact(
        self, answer: _Linear, command: Array, mean: Array, covariance: Array, unrest: Array
    ) -> _Linear:
        """The observation linear about the machine at rest under the likeliest contact."""
        for _ in range(2):
            seen, stated = answer
            link = int(stated["contact_evidence"][0].argmax())
            if stated["contact_evidence"][0, link] <= 0.0:
                return answer
            point_m = np.array([float(stated["place_m"][0]), 0.0, 0.0])
            contact = LinkForce(link, point_m, stated["force_n"][0])
            try:
                pose = self.observer.pose_under(contact, command, mean, seen.pose)
            except MachineError:
                # a contact that the machine would not bear is none to be linear about
                return answer
            again = self.observer.observe(seen.reading, command, mean, covariance, unrest, pose)
            answer = _Linear(again, self._stated(again))
        return answer

    def _stated(self, seen: Observation) -> dict[str, Array]:
        scale = self._per_newton
        stated = dict(self._state(evidence_of(seen, self._largest_n)))
        for name in _OF_FORCE:
            stated[name] = stated[name] / scale
        units = np.array([1.0, scale, scale, scale])
        stated["contact_covariance"] = stated["contact_covariance"] / np.outer(units, units)
        return stated


def evidence_of(seen: Observation, largest_n: float) -> dict[str, Array]:
    """`EVIDENCE` of an observation, in a unit of force by which `largest_n` is `GRAPH_FORCE_N`."""
    scale = GRAPH_FORCE_N / largest_n
    informed_by_torque = seen.information @ seen.by_torque
    informed_by_channel = seen.information @ seen.by_channel
    pull = seen.innovation @ seen.information
    evidence = (
        seen.reading * scale,
        pull @ seen.by_channel / scale,
        seen.by_channel.T @ informed_by_channel / scale**2,
        seen.by_channel.T @ informed_by_torque / scale**2,
        seen.by_torque.T @ informed_by_torque / scale**2,
        seen.innovation @ informed_by_torque / scale,
        np.array(pull @ seen.innovation),
        seen.levers,
        seen.torsion,
    )
    rows = {"reading_n", "channel_pull", "torque_pull"}
    return {
        name: value[None, None] if name in rows else value[None]
        for name, value in zip(EVIDENCE, evidence, strict=True)
    }
