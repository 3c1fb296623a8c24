"""Effects between the commanded and the held cable length."""

from __future__ import annotations

import numpy as np

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

    def step(self, time_s: float, held_m: Array) -> Array:
        if self._held_m is None:
            self._held_m = held_m + self._start * self._half_m
        self._held_m = np.clip(self._held_m, held_m - self._half_m, held_m + self._half_m)
        return np.where(chosen(self._place, held_m.shape[-1]), self._held_m, held_m)
