"""A zero that wanders with time."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.effects.effect import Effect, Instant, Parameter, Sensing, Values, chosen

INTERVAL_S = 30.0
"""Between these moments the zero moves at an even pace."""

_INTERVALS = 10


class SensorDrift(Effect):
    """A sensor whose zero moves, by another amount in each half minute; then it stands still.

    Equal independent rises make a random walk, which is what zeros do (IEEE Std 1293-2018).
    """

    name = "sensor_drift"
    acts_on = "sensor"
    about = "a zero of tension sensors that wanders"
    source = "IEEE Std 1293-2018, annex on bias instability and random walk"
    sites = ("cable",)
    advice = "Let the sensors warm up; look at their supply and cabling; tare often."
    needs_time = True
    parameters = (
        Parameter("start_n", "N", -20.0, 20.0, 0.7, "zero error at the beginning", past=True),
        *(
            Parameter(
                f"rise_{k + 1}_n", "N", -20.0, 20.0, 0.7,
                f"movement of the zero from {k * INTERVAL_S:g} to {(k + 1) * INTERVAL_S:g} s",
            )
            for k in range(_INTERVALS)
        ),
    )  # fmt: skip

    def sensing(self, place: str, values: Values) -> Sensing:
        rises_n = np.stack([values[p.name] for p in self.parameters[1:]], axis=-1)

        def wandering(time_s: float | Array, tensions_n: Array) -> Array:
            passed = np.asarray(time_s)[..., None] / INTERVAL_S
            done = np.clip(passed - np.arange(_INTERVALS), 0.0, 1.0)
            drift = (values["start_n"] + done @ rises_n.T)[..., None]
            return tensions_n + drift * chosen(place, tensions_n.shape[-1])

        return Instant(wandering)
