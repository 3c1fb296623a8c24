"""An effect of one's own: a sensor that reads nothing below a threshold.

    python -m examples.own_effect

An installed package offers the class under the entry point group `cablesense.effects`; arm files,
training and the diagnosis then know it by its name (docs/effects.md).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cablesense_base import Array
from cablesense_sim.effects.effect import Effect, Instant, Parameter, Sensing, chosen


class SensorDeadband(Effect):
    """A sensor that reads nothing below a threshold."""

    name = "sensor_deadband"
    acts_on = "sensor"
    about = "readings that are zero below a threshold"
    source = "an example"
    sites = ("cable",)
    advice = "Measure the threshold with small weights."
    parameters = (Parameter("threshold_n", "N", 0.0, 20.0, 1.0, "below which nothing is read"),)

    def sensing(self, place: str, values: Mapping[str, Array]) -> Sensing:
        """Readings of the cable at `place`; every value is an array (P,), one for each arm."""

        def deadband(time_s: float | Array, tensions_n: Array) -> Array:
            low = tensions_n < values["threshold_n"][:, None]
            return np.where(chosen(place, tensions_n.shape[-1]) & low, 0.0, tensions_n)

        return Instant(deadband)


def main() -> None:
    """Show what the effect does to three readings of cable_2."""
    tensions_n = np.array([[5.0, 0.4, 3.0], [5.0, 1.4, 3.0]])
    sensing = SensorDeadband().sensing("cable_2", {"threshold_n": np.ones(2)})
    print(sensing.step(0.0, tensions_n))


if __name__ == "__main__":
    main()
