"""Friction where cables run over guides and pulleys."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cablesense_sim.effects.effect import Array, Effect, Parameter, Values
from cablesense_sim.effects.transmission import Rest, Transmission, drawn_m

if TYPE_CHECKING:
    from cablesense_sim.mechanism import Mechanism


class CapstanFriction(Effect):
    """Stick and slip over each guide, with tensions apart by at most exp(μ θ).

    Each guide carries a share of what it could hold, between -1 and 1. It grows evenly with the
    cable that is drawn past until the cable slips, and it lasts at rest. The wrap angle θ is what
    the cable turns by at a guide, and at the actuator's pulley that of the drawing.
    """

    name = "capstan_friction"
    acts_on = "transmission"
    about = "friction where cables run over guides and pulleys, with tension and wrap angle"
    source = "equation (2) of the paper: T_out = T_in exp(-μ θ); presliding after Dahl, 1968"
    parameters = (
        Parameter("coefficient", "1", 0.0, 1.5, 0.1, "of friction between cable and guide"),
        Parameter(
            "pulley_wrap_rad",
            "rad",
            0.0,
            20.0,
            1.0,
            "wrap angle at the actuator's pulley",
            0.0,
            "shape",
            (0.5,),
            (0.0, 0.5, 3.0),
        ),
        Parameter(
            "give_m",
            "m",
            1e-6,
            2e-3,
            5e-5,
            "of cable drawn past from rest to slip",
            2e-5,
            "shape",
            (2e-5,),
            (1e-5, 1e-4),
        ),
        Parameter(
            "start", "1", -1.0, 1.0, 0.5, "share of the holding that the past left", role="shape"
        ),
    )

    def transmission(self, place: str, values: Values) -> Transmission:
        return _Capstan(values)


class _Capstan(Transmission):
    """Guides 0 (the actuator's pulley) and 1 to N (both guides of a joint as one)."""

    def __init__(self, values: Values) -> None:
        self._coefficient = values["coefficient"][:, None, None]
        self._pulley_rad = values["pulley_wrap_rad"][:, None]
        self._give_m = values["give_m"][:, None, None]
        self._start = values["start"][:, None, None]

    def begin(self, mechanism: Mechanism, rest: Rest) -> None:
        self._drawn_m = _drawn_with_pulley_m(rest.spans_m)
        self._share = np.broadcast_to(self._start, self._drawn_m.shape)

    def tension_log_loss(self, spans_m: Array, bends_rad: Array) -> tuple[Array, Array]:
        free = self._free_share(spans_m)
        share = np.clip(free, -1.0, 1.0)
        sticks = np.abs(free) < 1.0
        before, after = bends_rad[..., 0], bends_rad[..., 1]
        held = share[..., 1:] * (before + after)
        earlier = np.cumsum(held, axis=-1) - held
        pulley = (self._pulley_rad * share[..., 0])[..., None]
        loss = self._coefficient * (pulley + earlier + share[..., 1:] * before)
        count = spans_m.shape[-1]
        wrap = np.where(
            np.tri(count, k=-1, dtype=bool),
            (before + after)[..., None, :],
            np.eye(count) * before[..., None, :],
        )
        slope = wrap * (sticks[..., 1:] / self._give_m)[..., None, :]
        pull = (self._pulley_rad * sticks[..., 0])[..., None, None] / self._give_m[..., None]
        slope[..., 0] += np.broadcast_to(pull, slope.shape)[..., 0]
        return loss, self._coefficient[..., None] * slope

    def settle(self, rest: Rest) -> None:
        self._share = np.clip(self._free_share(rest.spans_m), -1.0, 1.0)
        self._drawn_m = _drawn_with_pulley_m(rest.spans_m)

    def _free_share(self, spans_m: Array) -> Array:
        moved = _drawn_with_pulley_m(spans_m) - self._drawn_m
        return np.asarray(self._share + moved / self._give_m)


def _drawn_with_pulley_m(spans_m: Array) -> Array:
    """(P, M, 1 + N): at the pulley the whole cable is drawn past."""
    total = -spans_m.sum(axis=-1, keepdims=True)
    return np.concatenate([total, drawn_m(spans_m)], axis=-1)
