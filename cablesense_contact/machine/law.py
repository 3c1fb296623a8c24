"""The law of a machine: observations by MuJoCo's statics, and the statement of a graph on them.

It answers as the law of an arm does (`cablesense_contact.law`), with links for segments, D
observations for M innovations, and n coordinates for 2N joint angles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from cablesense_base import Array
from cablesense_contact.law import LawOutput
from cablesense_contact.machine.observation import Observation, Observer
from cablesense_contact.machine.soft_contacts import Reading, SoftContacts
from cablesense_sim.machine.machine import Machine

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
    "log_share",
)
"""Inputs of the graph in a machine's model file, see `cablesense_training.law.evidence`."""

STATED = (
    "contact_evidence",
    "segment_evidence",
    "several_evidence",
    "faulty_evidence",
    "faulty_segment_evidence",
    "exchanged_evidence",
    "free_chi2",
    "contact_chi2",
    "several_chi2",
    "place_m",
    "place_ci95_m",
    "region_m",
    "force_n",
    "contact_covariance",
    "magnitude_ci95_n",
    "moment_n_m",
    "moment_std_n_m",
    "fault_n",
)
"""Outputs of that graph: the fields of `cablesense_training.law.statement.Statement` in its order.
The other fields of `LawOutput` are computed from the observations."""

_OF_FORCE = ("force_n", "magnitude_ci95_n", "moment_n_m", "moment_std_n_m", "fault_n")
"""Outputs that scale with force."""


class Stater(Protocol):
    """States what evidence says: the graph in a model file, or its original."""

    def __call__(self, evidence: Mapping[str, Array]) -> Mapping[str, Any]:
        """`STATED` by `EVIDENCE`."""
        ...


class MachineLaw:
    """The law of one machine; a `cablesense_contact.law.Law`.

    Attributes:
        machine: the machine.
        observer: makes observations of its readings.
    """

    most_together = 1

    def __init__(self, machine: Machine, state: Stater) -> None:
        self.machine = machine
        self.observer = Observer(machine)
        self._state = state
        self._largest_n = machine.source.file.touch.largest_n
        self._soft = SoftContacts(self.observer, self._stated)
        self._per_newton = GRAPH_FORCE_N / self._largest_n

    def __call__(
        self,
        reading_n: Array,
        command_rad: Array,
        mean: Array,
        covariance: Array,
        unrest_n2_m2: Array,
    ) -> LawOutput:
        """What readings (B, M) say at commands (B, C), or at measured positions (B, n).

        The parameters have a mean (P,) and a covariance (P, P), torques by motion the covariance
        `unrest_n2_m2` (n, n).
        """
        rows = zip(reading_n, command_rad, strict=True)
        if self.observer.determines_pose:
            observed = [
                self.observer.observe(reading, command, mean, covariance, unrest_n2_m2)
                for reading, command in rows
            ]
            stated = self._stated(observed)
            untouched = observed
        else:
            answers = [
                self._soft.answer(Reading(reading, command, mean, covariance, unrest_n2_m2))
                for reading, command in rows
            ]
            observed = [answer.observation for answer in answers]
            untouched = [answer.untouched for answer in answers]
            stated = {
                name: np.concatenate([answer.stated[name] for answer in answers])
                for name in STATED
            }
        parts = _stacked(observed)
        # a force that takes a tendon slack reads as any larger one does
        stated["magnitude_ci95_n"][parts.is_slack, 1] = self._largest_n
        return LawOutput(
            **stated,
            innovation_n=np.stack([seen.innovation for seen in untouched]),
            information_n2=parts.information,
            by_parameter=np.stack([seen.by_parameter for seen in untouched]),
            by_torque=parts.by_torque,
            at_joint_m=parts.levers[:, :, :3],
            by_place=parts.levers[:, :, 3:],
            pose_rad=parts.pose,
        )

    def _stated(
        self, observed: Sequence[Observation], log_share: Array | None = None
    ) -> dict[str, Array]:
        """What the statement makes of observations; forces are scaled to those it is made for."""
        scale = self._per_newton
        stated = dict(self._state(evidence_of(observed, self._largest_n, log_share)))
        for name in _OF_FORCE:
            stated[name] = stated[name] / scale
        units = np.array([1.0, scale, scale, scale])
        stated["contact_covariance"] = stated["contact_covariance"] / np.outer(units, units)
        return stated


def evidence_of(
    observed: Sequence[Observation], largest_n: float, log_share: Array | None = None
) -> dict[str, Array]:
    """`EVIDENCE` of observations, in a unit of force by which `largest_n` is `GRAPH_FORCE_N`."""
    scale = GRAPH_FORCE_N / largest_n
    seen = _stacked(observed)
    innovation = seen.innovation[:, None]
    pull = innovation @ seen.information
    informed_by_torque = seen.information @ seen.by_torque
    informed_by_channel = seen.information @ seen.by_channel
    from_torque = seen.by_torque.transpose(0, 2, 1)
    from_channel = seen.by_channel.transpose(0, 2, 1)
    return {
        "reading_n": seen.reading[:, None] * scale,
        "channel_pull": pull @ seen.by_channel / scale,
        "channel_information": from_channel @ informed_by_channel / scale**2,
        "informed": from_channel @ informed_by_torque / scale**2,
        "torque_precision": from_torque @ informed_by_torque / scale**2,
        "torque_pull": innovation @ informed_by_torque / scale,
        "untouched_chi2": (pull * innovation).sum((1, 2)),
        "levers": seen.levers,
        "by_torsion": seen.torsion,
        "log_share": np.zeros(seen.levers.shape[:2]) if log_share is None else log_share,
    }


def _stacked(observed: Sequence[Observation]) -> Observation:
    """The observations of B readings as one, with a leading axis."""
    if len(observed) == 1:
        # of a single reading, as a node has, no number is copied
        return Observation._make(np.asarray(part)[np.newaxis] for part in observed[0])
    return Observation._make(np.stack(column) for column in zip(*observed, strict=True))
