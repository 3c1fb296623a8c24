"""The law that a model file holds: a reading, a command and a calibration in, a posterior out.

`training/law` makes it of array code and exports it as one ONNX graph; whoever answers readings
only knows these inputs and outputs.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from cablesense_base import Array


class LawOutput(NamedTuple):
    """What B readings say of an arm with N segments, M cables and P parameters.

    Log evidences are against "nothing touches the arm". Forces are along the axes that their
    segment has at the command; those of one contact are of the likeliest segment. A rival that was
    not computed, as it could not win, has a very low evidence.

    Attributes:
        contact_evidence: (B, N) of one contact on this segment.
        segment_evidence: (B, N) of any force and moment on this segment.
        several_evidence: (B,) of several contacts on the whole arm.
        faulty_evidence: (B, M) nothing touches, and this channel is wrong.
        faulty_segment_evidence: (B, M, N) any force on this segment, and this channel is wrong.
        exchanged_evidence: (B, M, M) nothing touches, and two channels are exchanged.
        free_chi2, contact_chi2, several_chi2: (B,) that nothing, one contact, and several leave.
        place_m: (B,) mean distance of the contact from the joint centre.
        place_ci95_m: (B, 2) interval of it.
        region_m: (B, 2) interval of the place over all segments, from the first joint centre along
            the straight arm.
        force_n: (B, 3) mean.
        contact_covariance: (B, 4, 4) of place, m, and force, N.
        magnitude_ci95_n: (B, 2) interval of the lateral force; of a machine's, on whichever link.
        moment_n_m, moment_std_n_m: (B, 2) about the joint centre, around y and z.
        fault_n: (B, M) what each channel reads too much if nothing touches and it is wrong, in
            the channel's unit, N or N·m.
        innovation_n: (B, M) reading minus that of the untouched arm, in the channels' units; of a
            machine whose joints are measured, torques of its joints. With `by_parameter` it is
            about the untouched machine also where fewer channels than joints let each contact
            have a pose of its own, about which the other derivatives are.
        information_n2: (B, M, M) inverse covariance of innovations.
        by_parameter: (B, M, P) derivative of readings by the parameters.
        by_torque: (B, M, 2N) derivative of readings by contact torques.
        at_joint_m, by_place: (B, N, 3, 2N) torques of unit forces at the joint centres, and their
            derivative by the distance from these.
        pose_rad: (B, 2N) joint angles.
    """

    contact_evidence: Array
    segment_evidence: Array
    several_evidence: Array
    faulty_evidence: Array
    faulty_segment_evidence: Array
    exchanged_evidence: Array
    free_chi2: Array
    contact_chi2: Array
    several_chi2: Array
    place_m: Array
    place_ci95_m: Array
    region_m: Array
    force_n: Array
    contact_covariance: Array
    magnitude_ci95_n: Array
    moment_n_m: Array
    moment_std_n_m: Array
    fault_n: Array
    innovation_n: Array
    information_n2: Array
    by_parameter: Array
    by_torque: Array
    at_joint_m: Array
    by_place: Array
    pose_rad: Array

    def row(self, index: int) -> LawOutput:
        """The answer to one of the readings, as a batch of one."""
        return LawOutput._make(part[index : index + 1] for part in self)


GRAPH_INPUTS = ("reading_n", "command_rad", "mean", "covariance", "unrest_n2_m2")
"""Names of the inputs of a model file, in the order of `Law`."""


class Law(Protocol):
    """Answers readings (B, M) at commands (B, 2N) by parameters with a mean and a covariance.

    Attributes:
        most_together: as many readings are best answered in one call where several wait; 1 where
            that takes as long as one after the other.
    """

    most_together: int

    def __call__(
        self,
        reading_n: Array,
        command_rad: Array,
        mean: Array,
        covariance: Array,
        unrest_n2_m2: Array,
    ) -> LawOutput:
        """The posterior; `unrest_n2_m2` (2N, 2N) is the covariance of torques by motion."""
        ...


def no_unrest(torque_count: int) -> Array:
    """(T, T) covariance, (N·m)², of the torques by motion of a machine at rest: zero."""
    return np.zeros((torque_count, torque_count))
