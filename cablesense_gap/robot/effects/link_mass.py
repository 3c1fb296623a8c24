"""A link that weighs something else than the model says."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import Effect, Parameter, Scale, Values, size
from cablesense_gap.robot.model import Change, Robot


class LinkMass(Effect):
    """Mass and inertia of a link that are off by the same share."""

    name = "link_mass"
    about = "a wrong link mass"
    advice = "Weigh the link, or compare its mass with the drawing's."

    def places(self, robot: Robot) -> tuple[str, ...]:
        return robot.bodies

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (size("share", "1", 3.0, 0.1, "heavier than modelled", -0.9),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.mass_kg[at] *= 1.0 + values["share"]
        change.inertia_kg_m2[at] *= 1.0 + values["share"]
