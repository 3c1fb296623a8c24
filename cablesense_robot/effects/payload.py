"""Mass that nobody modelled."""

from __future__ import annotations

import numpy as np

from cablesense_robot.effects.effect import Effect, Parameter, Scale, Values, rms, size
from cablesense_robot.model import Change, Robot
from cablesense_sim.effects.effect import shape


class Payload(Effect):
    """A point mass fixed to a body: a tool, a camera, a cable chain."""

    name = "payload"
    about = "mass that nobody modelled"
    source = "Featherstone, Rigid Body Dynamics Algorithms, 2008, section 2.13"
    advice = "Weigh what was added there: tools, cameras, covers, cables."

    def places(self, robot: Robot) -> tuple[str, ...]:
        return robot.bodies

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        """Mass, and place in the body's axes from its centre of mass."""
        typical = 0.1 * rms(robot.model.body_mass[robot.body_ids])
        reach = max(float(np.abs(robot.model.body_pos[1:]).max()), 0.05)
        about = "from the body's centre of mass, in its axes"
        return (
            size("mass_kg", "kg", 100.0 * typical, typical, "of what was added", 0.0),
            *(shape(f"{a}_m", "m", -2.0 * reach, 2.0 * reach, 0.3 * reach, about) for a in "xyz"),
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        place = change.centre_m[at] + [values[f"{axis}_m"] for axis in "xyz"]
        change.add_point_mass(at, values["mass_kg"], place)
