"""What the networks answer, in physical units."""

from typing import NamedTuple

from torch import Tensor


class SingleContactOutput(NamedTuple):
    """Answer for B tension differences of an arm with N segments.

    Attributes:
        contact_logits: (B, N + 1) no contact, segment 1 … N; their softmax is the contact
            probability.
        direction: (B, 2) (sin θ, cos θ) of the contact angle, not necessarily of unit length.
        magnitude_n: (B,) force magnitude.
        magnitude_std_n: (B,) stated standard deviation of the magnitude.
        angle_std_deg: (B,) stated standard deviation of the contact angle.
    """

    contact_logits: Tensor
    direction: Tensor
    magnitude_n: Tensor
    magnitude_std_n: Tensor
    angle_std_deg: Tensor


class MultiContactOutput(NamedTuple):
    """Answer for B tension differences, each segment of N touched or not.

    Attributes:
        contact_logits: (B, N) their sigmoid is the probability that a segment is touched.
        magnitude_n: (B, N) force magnitudes, meant where the segment is touched.
        magnitude_std_n: (B, N) stated standard deviations of the magnitudes.
    """

    contact_logits: Tensor
    magnitude_n: Tensor
    magnitude_std_n: Tensor
