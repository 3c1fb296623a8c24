"""Effects on what goes into an arm: held cable lengths against the command, acting loads."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cablesense_base import Array
from cablesense_sim.effects.effect import Actuation, Effect, Parameter, Values, chosen, shape


class ActuatorBacklash(Effect):
    """Play between screw and nut: the held length follows the command half the play behind."""

    name = "actuator_backlash"
    acts_on = "actuator"
    about = "lost motion of actuators on reversal"
    source = "Nordin and Gutman, Controlling mechanical systems with backlash, Automatica 2002"
    sites = ("cable",)
    advice = "Check couplings and nuts of these actuators, or approach poses from one side."
    parameters = (
        Parameter("play_m", "m", 0.0, 0.005, 5e-5, "between the two flanks",
                  starts=(5e-5, 2.5e-4)),
        shape("start", "1", -1.0, 1.0, 1.0,
              "where in the play it begins, from the short to the long side", past=True),
    )  # fmt: skip

    def actuation(self, place: str, values: Values) -> Actuation:
        return _Play(place, values["play_m"], values["start"])


class _Play(Actuation):
    def __init__(self, place: str, play_m: Array, start: Array) -> None:
        self._place, self._half_m, self._start = place, 0.5 * play_m[:, None], start[:, None]
        self._held_m: Array | None = None

    def step(self, time_s: float, values: Array) -> Array:
        if self._held_m is None:
            self._held_m = values + self._start * self._half_m
        self._held_m = np.clip(self._held_m, values - self._half_m, values + self._half_m)
        return np.where(chosen(self._place, values.shape[-1]), self._held_m, values)


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
