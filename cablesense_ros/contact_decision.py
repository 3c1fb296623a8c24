"""Whether what a model says of a sample is a contact, and which one."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from cablesense_msgs_py.contact import NO_CONTACT, Contact
from cablesense_ros.sample_error import ProblemKind, SampleError


class ContactDecision:
    """Takes the likeliest segment, once a contact anywhere is likely enough.

    Attributes:
        threshold: probability of a contact anywhere from which on there is one.
    """

    def __init__(self, contact_m: Sequence[float], threshold: float) -> None:
        """`contact_m` (N,) says where on its axis each segment is touched, from its joint on."""
        self._contact_m = contact_m
        self.threshold = threshold

    def decide(
        self, probabilities: Sequence[float], angle_deg: float, magnitude_n: float
    ) -> Contact:
        """The contact, or `NO_CONTACT`.

        Args:
            probabilities: (N+1,) of no contact, segment 1, ….
            angle_deg: contact angle.
            magnitude_n: of the force; one that does not push is no contact.

        Raises:
            SampleError: a number is not finite.
        """
        if not (isfinite(sum(probabilities)) and isfinite(angle_deg) and isfinite(magnitude_n)):
            raise SampleError(
                ProblemKind.ESTIMATE, "the model gave a number that is not finite for this sample"
            )
        if 1.0 - probabilities[0] < self.threshold or magnitude_n <= 0.0:
            return NO_CONTACT
        segment = max(range(1, len(probabilities)), key=probabilities.__getitem__)
        return Contact(segment, angle_deg, magnitude_n, self._contact_m[segment - 1])
