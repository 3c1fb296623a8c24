"""Which joint angles may be commands: a range that angles in degrees leave."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_contact.errors import EstimateError


def require_commands(commands_rad: Array) -> None:
    """Require that commanded joint angles (B, 2N) are within half a turn.

    Raises:
        EstimateError: an angle is more, as in degrees, or not finite.
    """
    largest_rad = float(np.abs(commands_rad).max(initial=0.0))
    if not largest_rad <= np.pi:
        raise EstimateError(
            f"a commanded joint angle of {largest_rad:g} rad is more than half a turn or not "
            "finite; commands are in rad, not in degrees"
        )
