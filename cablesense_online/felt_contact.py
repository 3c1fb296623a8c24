"""Of a contact what a machine feels, which is what its estimator states."""

from __future__ import annotations

import math

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact


def felt_part(contact: Contact, projection: Array) -> Contact:
    """The contact with the felt part of its force across the link, by a projection (2, 2).

    The projection is one of `cablesense_contact.felt.FeltMachine.felt_across`.
    """
    y, z = projection @ np.array(contact.direction)
    return contact._replace(
        angle_deg=math.degrees(math.atan2(y, z)) % 360.0,
        magnitude_n=contact.magnitude_n * math.hypot(y, z),
    )
