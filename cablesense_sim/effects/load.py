"""Effects between the load that is recorded and the load that acts."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cablesense_base import Array
from cablesense_sim.effects.effect import Effect, Parameter, Values

_TURN = "of the load that acts against the recorded one, about the base's {} axis"


class LoadCell(Effect):
    """A load cell of another scale, or turned against the base.

    It belongs to the recording: the arm itself and its sensors are as they should be.
    """

    name = "load_cell"
    acts_on = "load"
    about = "a load cell whose scale or axes are not as recorded"
    source = "Lynch and Park, Modern Robotics, 2017, section 3.4: a wrench in another frame"
    advice = (
        "Hang a known weight on the load cell; check how its axes stand against those of the "
        "base, in which loads are recorded."
    )
    parameters = (
        Parameter(
            "scale", "1", -0.6, 1.0, 0.02, "share by which the acting load is larger",
            relative=True,
        ),
        *(
            Parameter(f"turn_{axis}_rad", "rad", -0.8, 0.8, 0.03, _TURN.format(axis))
            for axis in "xyz"
        ),
    )  # fmt: skip

    def loading(self, place: str, values: Values) -> Array:
        turn = Rotation.from_rotvec(np.stack([values[f"turn_{a}_rad"] for a in "xyz"], axis=-1))
        return np.asarray((1.0 + values["scale"])[:, None, None] * turn.as_matrix())
