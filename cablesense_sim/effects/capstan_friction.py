"""Friction where cables run over guides and pulleys."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.effects.effect import (
    ROUNDED,
    DryContact,
    Effect,
    Kept,
    Parameter,
    Rest,
    Transmission,
    Values,
    cables,
    shape,
)
from cablesense_sim.mechanism import Mechanism


class CapstanFriction(Effect):
    """Stick and slip over each guide, with tensions apart by at most exp(μ θ).

    Each guide carries a share of what it could hold, between -1 and 1. It grows evenly with the
    cable that is drawn past until the cable slips, and it lasts at rest. The wrap angle θ is what
    the cable turns by at a guide, and at the actuator's pulley that of the drawing.
    """

    name = "capstan_friction"
    acts_on = "transmission"
    about = "friction of the cables over guides and pulleys"
    source = "equation (2) of the paper: T_out = T_in exp(-μ θ); presliding after Dahl, 1968"
    advice = (
        "Look for worn, dry or misaligned guides. The estimator is blind to loads within the "
        "loop that friction opens; train it on the amended arm."
    )
    parameters = (
        Parameter("coefficient", "1", 0.0, 1.5, 0.1, "of friction between cable and guide"),
        shape("pulley_wrap_rad", "rad", 0.0, 20.0, 1.0, "wrap angle at the actuator's pulley",
              starts=(0.5,), trials=(0.0, 1.0)),
        shape("give_m", "m", 1e-6, 2e-3, 5e-5, "of cable drawn past from rest to slip", 2e-5,
              starts=(2e-5,), trials=(1e-5, 1e-4)),
        shape("run_share", "1", 0.0, 1.0, 0.5,
              "share of the cable's give that lies beyond the actuator's pulley",
              trials=(0.0, 1.0)),
        ROUNDED,
    )  # fmt: skip

    def history(self, segment_count: int, cable_count: int) -> tuple[Parameter, ...]:
        about = "share of what its guides hold that the past left on"
        return tuple(
            shape(f"start_{cable}", "1", -1.0, 1.0, 0.5, f"{about} {cable}")
            for cable in cables(cable_count)
        )

    def transmission(self, place: str, values: Values) -> Transmission:
        return _Capstan(values)


class _Capstan(Transmission):
    """Guides 0 (the actuator's pulley), 1 to N before the joints, and N + 1 to 2N after them."""

    def __init__(self, values: Values) -> None:
        self._coefficient = values["coefficient"][:, None, None]
        self._pulley_rad = values["pulley_wrap_rad"][:, None, None]
        self._give_m = values["give_m"][:, None, None]
        self._rounded = values["rounded"][:, None, None]
        self._run = values["run_share"][:, None, None]
        self._before = 1.0 - values["run_share"][:, None]
        self._values = values

    def begin(self, mechanism: Mechanism, rest: Rest) -> None:
        none = np.zeros_like(self._values["coefficient"])
        names = (f"start_{cable}" for cable in cables(mechanism.cable_count))
        start = np.stack([self._values.get(name, none) for name in names], axis=-1)
        drawn = self._drawn_m(rest.spans_m)
        self._contact = DryContact(self._give_m, self._rounded, start[..., None], drawn)

    def hold(self, rest_m: Array) -> None:
        self._rest_m = rest_m

    def kept_tension(self, spans_m: Array, bends_rad: Array) -> Kept:
        share, by_drawn = self._contact.share(self._drawn_m(spans_m))
        kept = np.exp(-self._up_to_span(share, bends_rad))
        # a span's length draws at the guides on its actuator's side, and a loss counts those
        at_pulley, at_guides = by_drawn.copy(), by_drawn.copy()
        at_pulley[..., 1:], at_guides[..., 0] = 0.0, 0.0
        count = spans_m.shape[-1]
        nearer = np.minimum.outer(np.arange(count), np.arange(count))
        loss_by_m = -self._up_to_span(at_guides, bends_rad)[..., nearer]
        by_pulley_m = self._up_to_span(at_pulley, bends_rad)[..., nearer]
        loss_by_m -= self._before[..., None, None] * by_pulley_m
        pulley = (self._coefficient * self._pulley_rad)[..., 0]
        run = self._run[..., 0] * np.exp(-pulley * share[..., 0])
        by_pulley = (run * pulley * by_drawn[..., 0])[..., None] * self._before[..., None]
        return Kept(
            kept,
            -kept[..., None] * loss_by_m,
            self._before + run,
            np.broadcast_to(by_pulley, spans_m.shape),
        )

    def settle(self, rest: Rest) -> None:
        self._contact.settle(self._drawn_m(rest.spans_m))

    def _up_to_span(self, of_guide: Array, bends_rad: Array) -> Array:
        """(P, M, N) sum over the guides on each span's actuator's side, of wrap times a number."""
        count = bends_rad.shape[-2]
        before = np.cumsum(bends_rad[..., 0] * of_guide[..., 1 : count + 1], axis=-1)
        after = bends_rad[..., 1] * of_guide[..., count + 1 :]
        passed = np.cumsum(after, axis=-1) - after
        pulley = self._pulley_rad * of_guide[..., :1]
        return np.asarray(self._coefficient * (pulley + before + passed))

    def _drawn_m(self, spans_m: Array) -> Array:
        """(P, M, 1 + 2N) how far each cable lies drawn towards its actuator at every guide.

        The far end is fixed, so what has shrunk beyond a guide has passed it; at the pulley so
        has what the run is stretched by.
        """
        with_own = np.flip(np.cumsum(np.flip(spans_m, -1), -1), -1)
        beyond = with_own - spans_m
        whole = with_own[..., :1]
        slackness = np.minimum(self._rest_m[..., None] - whole, 0.0)
        passed = whole + self._run * slackness
        return -np.concatenate([passed, with_own, beyond], axis=-1)
