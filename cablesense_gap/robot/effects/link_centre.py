"""A link whose centre of mass is not where the model has it."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import Effect, Parameter, Scale, Values, size
from cablesense_gap.robot.model import Change, Robot


class LinkCentre(Effect):
    """A centre of mass that is shifted in the link's axes."""

    name = "link_centre"
    about = "a wrong centre of mass"
    advice = "Balance the link on an edge, or compare with the drawing."

    def places(self, robot: Robot) -> tuple[str, ...]:
        return robot.bodies

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        reach = robot.reach_m
        return tuple(
            size(f"{axis}_m", "m", reach, 0.1 * reach, f"along the link's {axis}")
            for axis in "xyz"
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        change.centre_m[at] += [values[f"{axis}_m"] for axis in "xyz"]
