"""Friction where cables run over guides and pulleys."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.effects.effect import (
    Effect,
    Parameter,
    Pull,
    Rest,
    Transmission,
    Values,
    cables,
    shape,
    start_share,
)
from cablesense_sim.mechanism import Mechanism

_LOCKED = 3.0
"""A ratio of tensions of exp(3) at one guide is none that a cable reaches before it breaks."""


class CapstanFriction(Effect):
    """Cables that stick and slip at their guides, with tensions apart by at most exp(μ θ).

    The wrap angle θ is what a cable turns by at the guides around each joint, besides what it
    turns by there in a straight arm and, between its run and the base plate, at a pulley.
    """

    name = "capstan_friction"
    acts_on = "transmission"
    about = "friction of the cables over guides and pulleys"
    source = "equation (2) of the paper: T_out = T_in exp(-μ θ); see cablesense_sim.cable_chain"
    advice = (
        "Look for worn, dry or misaligned guides. Readings do not show loads within the loop that "
        "friction opens: let the arm breathe (docs/breathing.md) before a force is trusted."
    )
    version = 2  # before, the whole cable stretched as one
    parameters = (
        Parameter("coefficient", "1", 0.0, 1.5, 0.1, "of friction between cable and guide"),
        shape("pulley_wrap_rad", "rad", 0.0, 20.0, 1.0, "wrap angle at the actuator's pulley",
              starts=(0.5,), trials=(0.0, 1.0)),
        shape("guide_wrap_rad", "rad", 0.0, 20.0, 1.0,
              "wrap angle at the guides between two joints with the arm straight",
              trials=(0.0, 1.0)),
        shape("run_compliance", "1", 0.01, 100.0, 1.0,
              "compliance of the run before the pulley, over that by its length", 1.0,
              starts=(1.0,)),
        shape("give_m", "m", 0.0, 2e-3, 2e-5,
              "of cable that passes a guide from rest to slip; zero sticks rigidly",
              trials=(0.0, 3e-5)),
        shape("rounding", "1", 0.0, 0.95, 0.5,
              "of the way from rest to slip: Dahl's exponent; at zero it slips at once",
              trials=(0.5,)),
    )  # fmt: skip

    def history(self, segment_count: int, cable_count: int) -> tuple[Parameter, ...]:
        share = "share of what its guides hold that the past left on"
        return tuple(
            start_share(f"start_{cable}", about=f"{share} {cable}")
            for cable in cables(cable_count)
        )

    def transmission(self, place: str, values: Values) -> Transmission:
        return _Guides(values)


class _Guides(Transmission):
    """A node before each joint, with the guide behind the joint before it; the first's pulley."""

    def __init__(self, values: Values) -> None:
        self._values = values

    def begin(self, mechanism: Mechanism, rest: Rest) -> None:
        none = np.zeros_like(self._values["coefficient"])
        self._coefficient = (self._values["coefficient"][:, None] * mechanism.relative_friction)[
            ..., None
        ]
        names = (f"start_{cable}" for cable in cables(mechanism.cable_count))
        start = np.stack([self._values.get(name, none) for name in names], axis=-1)
        limit = self._limit(rest.bends_rad)
        compliance_m_n = self._pieces_m_n(mechanism)
        self._longer = compliance_m_n / compliance_m_n.sum(-1, keepdims=True)
        from cablesense_sim.cable_chain import CableChains  # compiled: none without friction waits

        self._chains = CableChains(
            compliance_m_n,
            self._lengths_m(rest.spans_m),
            limit,
            np.broadcast_to(start[..., None], limit.shape),
            self._values["give_m"][:, None, None],
            self._values["rounding"][:, None, None],
        )

    def hold(self, rest_m: Array, longer_m: Array) -> None:
        self._rest_m, self._longer_m = rest_m, longer_m

    def pull(self, spans_m: Array, bends_rad: Array) -> Pull:
        return self._chains.pull(self._lengths_m(spans_m), self._limit(bends_rad))

    def balancing_turn_rad(
        self,
        spans_m: Array,
        bends_rad: Array,
        by_turn_m: Array,
        torque_n_m: Array,
        slope_n_m: Array,
    ) -> Array | None:
        lengths, limit = self._lengths_m(spans_m), self._limit(bends_rad)
        return self._chains.balancing_turn_rad(lengths, limit, by_turn_m, torque_n_m, slope_n_m)

    def settle(self, rest: Rest) -> None:
        self._chains.settle(self._lengths_m(rest.spans_m), self._limit(rest.bends_rad))

    def _pieces_m_n(self, mechanism: Mechanism) -> Array:
        """(P, M, 1 + N) compliances, which add up to that of the cable and its actuator."""
        whole = 1.0 / mechanism.stiffness_n_m
        actuator = np.minimum(1.0 / mechanism.actuator_stiffness_n_m, whole)
        length = mechanism.piece_length_m
        pieces = (whole - actuator)[..., None] * length / length.sum(-1, keepdims=True)
        pieces[..., 0] = (pieces[..., 0] + actuator) * self._values["run_compliance"][:, None]
        return np.asarray(pieces * (whole / pieces.sum(-1))[..., None])

    def _lengths_m(self, spans_m: Array) -> Array:
        """(P, M, 1 + N), from where the whole cable is just slack; what creeps does so evenly."""
        lengths = np.concatenate([-self._rest_m[..., None], spans_m], axis=-1)
        return np.asarray(lengths - self._longer * self._longer_m[..., None])

    def _limit(self, bends_rad: Array) -> Array:
        """(P, M, N) μ θ of the nodes."""
        wraps = bends_rad[..., 0].copy()
        wraps[..., 1:] += bends_rad[..., :-1, 1] + self._values["guide_wrap_rad"][:, None, None]
        wraps[..., 0] += self._values["pulley_wrap_rad"][:, None]
        limit = self._coefficient * wraps
        return np.minimum(limit, _LOCKED)
