"""The estimate of one contact, or none, as it is published."""

from __future__ import annotations

from typing import NamedTuple

from cablesense_base import Array

NORMAL_95 = 1.959964
"""Standard deviations on either side of the mean that hold 95 % of a normal distribution."""


class ContactPlace(NamedTuple):
    """The place of a contact on its segment, with its axial force and its moment.

    Attributes:
        place_m: distance from the segment's joint centre.
        low_m, high_m: between which it lies with 95 %; beyond the segment's ends, along the arm,
            where the neighbour may be touched.
        along_n: force along the segment, towards its end.
        covariance: (4, 4) of the place, m, and the force along the segment's axes, N.
        moment_n_m: of the force about the joint centre.
        force_known: whether readings determine the lateral force; else only its moment.
    """

    place_m: float
    low_m: float
    high_m: float
    along_n: float
    covariance: Array
    moment_n_m: float
    force_known: bool


class Estimate(NamedTuple):
    """One contact, or none.

    Attributes:
        probabilities: (N + 1,) of no contact and of segment 1 … N.
        segment: the likeliest of them; 0 is no contact.
        angle_deg: contact angle in [0, 360), in the normal plane of the segment at the commanded
            angles, from +z towards +y.
        magnitude_n: force; without a contact, that of the likeliest segment.
        low_n, high_n: between which the force lies with 95 %, where there is a contact.
        place: of a contact anywhere; None from a network of contacts at the arm file's points.
        misfit_n: RMS of the tension differences that no force on the arm makes.
        plausible: whether that is little enough; if not, the rest of the estimate says nothing.
    """

    probabilities: Array
    segment: int
    angle_deg: float
    magnitude_n: float
    magnitude_std_n: float
    angle_std_deg: float
    low_n: float
    high_n: float
    place: ContactPlace | None = None
    misfit_n: float = 0.0
    plausible: bool = True
