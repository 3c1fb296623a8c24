"""What readings say of forces at the joints and of channels, whatever machine they are of."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from cablesense_training.law.measurement import Measurement


class Evidence(NamedTuple):
    """What B readings say; M channels, N links, T torques at the joints.

    An innovation x has the inverse covariance S⁻¹, the derivative D by torques and C by what
    channels read too much. C is the identity where innovations are of the channels themselves.

    Attributes:
        reading_n: (B, 1, M).
        channel_pull: (B, 1, M) x' S⁻¹ C.
        channel_information: (B, M, M) C' S⁻¹ C.
        informed: (B, M, T) C' S⁻¹ D.
        torque_precision: (B, T, T) D' S⁻¹ D.
        torque_pull: (B, 1, T) x' S⁻¹ D.
        untouched_chi2: (B,) x' S⁻¹ x.
        levers: (B, N, 6, T) torques of unit forces at the origins of the links' axis frames, and
            their derivatives by the distance along the links.
        by_torsion: (B, N, 1, T) torques of unit moments about the links' axes.
        log_share: (B, N) added to the log evidence of a contact on each link, for what is not
            linear; None where nothing is.
    """

    reading_n: Tensor
    channel_pull: Tensor
    channel_information: Tensor
    informed: Tensor
    torque_precision: Tensor
    torque_pull: Tensor
    untouched_chi2: Tensor
    levers: Tensor
    by_torsion: Tensor
    log_share: Tensor | None = None


def evidence_of(seen: Measurement) -> Evidence:
    """The evidence of an arm's measurement, whose innovations are of its channels."""
    pull = seen.innovation_n @ seen.information_n2
    return Evidence(
        reading_n=seen.reading_n,
        channel_pull=pull,
        channel_information=seen.information_n2,
        informed=seen.informed,
        torque_precision=seen.torque_precision,
        torque_pull=seen.torque_pull,
        untouched_chi2=(pull * seen.innovation_n).sum((1, 2)),
        levers=seen.levers,
        by_torsion=seen.by_torsion,
    )
