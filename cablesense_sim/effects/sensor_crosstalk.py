"""A share of one channel's signal in another."""

from __future__ import annotations

from cablesense_base import Array
from cablesense_sim.effects.effect import WHOLE_ARM, Effect, Instant, Parameter, Sensing, Values


class SensorCrosstalk(Effect):
    """Readings of one channel that carry a share of another's tension.

    Of the whole arm, every channel leaks into the two that are wired beside it.
    """

    name = "sensor_crosstalk"
    acts_on = "sensor"
    about = "crosstalk between tension sensors"
    source = "Doebelin, Measurement Systems, 5th ed. 2003, chapter 2: interfering inputs"
    advice = "Look at shared wiring, ground and amplifier of these channels."
    order = -3
    parameters = (
        Parameter("share", "1", -0.3, 0.3, 0.03, "share of the other channel's tension"),
    )

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        every = range(1, cable_count + 1)
        pairs = (f"cable_{a}_into_cable_{b}" for a in every for b in every if a != b)
        return (WHOLE_ARM, *pairs)

    def sensing(self, place: str, values: Values) -> Sensing:
        def leaking(_: float | Array, tensions_n: Array) -> Array:
            readings, share = tensions_n.copy(), values["share"]
            if place == WHOLE_ARM:
                readings[..., 1:] += share[:, None] * tensions_n[..., :-1]
                readings[..., :-1] += share[:, None] * tensions_n[..., 1:]
            else:
                source, target = (int(p.rsplit("_", 1)[1]) - 1 for p in place.split("_into_"))
                readings[..., target] += share * tensions_n[..., source]
            return readings

        return Instant(leaking)
