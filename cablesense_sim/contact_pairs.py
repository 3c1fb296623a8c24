"""Two contacts at once, anywhere on two segments, from the tensions of an arm.

The joint torques are linear in both forces once both places are given (`contact_location`), so the
fit is a profile over two places. 2N torques determine four numbers of each contact on an arm of
four segments, where the pose shows the axial forces and no contact is on segment 1; elsewhere the
standard deviations say so. Evidence by Laplace's approximation compares pairs of segments with one
another and with a single contact (MacKay, Information Theory, Inference, and Learning Algorithms,
2003, chapter 28).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.contact_location import LARGEST_N, Surface, TorqueBalance, compiled_input


class ContactPair(NamedTuple):
    """The two contacts that are most probable on each of B samples.

    Attributes:
        segments: (B, 2) from 1 on, in ascending order.
        place_m, place_std_m: (B, 2) distances from the segments' joint centres.
        force_n, force_std_n: (B, 2, 3) along the axes of the segments at the command.
        log_evidence: (B,) against no contact, with the prior of `locate`; compare it with
            `Location.log_evidence`.
        chi2: (B,) misfit, with 2N - 8 degrees of freedom where all is determined.
    """

    segments: NDArray[np.int64]
    place_m: Array
    place_std_m: Array
    force_n: Array
    force_std_n: Array
    log_evidence: Array
    chi2: Array


def locate_two(
    balance: TorqueBalance,
    reach: Array,
    largest_n: float = LARGEST_N,
    surface: Surface | None = None,
) -> ContactPair:
    """The two contacts from the balance of B samples, within a reach (N, 2), m.

    Contacts act on the axis if no `surface` is given; two are on different segments.
    """
    from cablesense_sim.contact_pair_fit import fit_each

    return fit_each(*compiled_input(balance, reach, surface, largest_n))
