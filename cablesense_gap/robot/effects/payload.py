"""Mass that nobody modelled."""

from __future__ import annotations

import numpy as np

from cablesense_gap.robot.effects.effect import Effect, Parameter, Scale, Values, rms, size
from cablesense_gap.robot.model import Change, Robot


class Payload(Effect):
    """A point mass fixed to a body: a tool, a camera, a cable chain."""

    name = "payload"
    about = "mass that nobody modelled"
    source = "Featherstone, Rigid Body Dynamics Algorithms, 2008, section 2.13"
    advice = "Weigh what was added there: tools, cameras, covers, cables."

    def places(self, robot: Robot) -> tuple[str, ...]:
        return robot.bodies

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        typical = 0.1 * rms(robot.model.body_mass[robot.body_ids])
        moment = 0.3 * typical * robot.reach_m
        about = "first moment about the body's centre of mass: over the mass it gives the place"
        return (
            size("mass_kg", "kg", 100.0 * typical, typical, "of what was added", 0.0),
            *(
                size(f"moment_{axis}_kg_m", "kg·m", 200.0 * moment, moment, about)
                for axis in "xyz"
            ),
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        moment = np.array([values[f"moment_{axis}_kg_m"] for axis in "xyz"])
        mass = max(values["mass_kg"], float(np.linalg.norm(moment)) / change.reach_m)
        if mass > 0.0:
            change.add_point_mass(at, mass, change.centre_m[at] + moment / mass)
