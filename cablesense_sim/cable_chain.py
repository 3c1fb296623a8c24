"""A cable with friction: elastic pieces in a row that stick and slip at the guides between them.

Piece 0 is the run at the actuator, and node k lies between pieces k and k + 1. The tensions on the
two sides of a node are always within the bounds

    exp(-φ) <= T_k / T_(k+1) <= exp(φ),    φ = μ θ,

and cable passes only at that bound (Coulomb's law on a round guide, after Euler and Eytelwein). A
piece between two nodes that stick carries what its own stretch gives and nothing else. How much
cable has passed is the state; it changes from rest to rest, by one implicit step each.

In the passed lengths this is a complementarity problem with two bounds and an M-matrix, so the
tensions are unique (Cottle, Pang and Stone, The Linear Complementarity Problem, 1992, chapter 3).
A whole cable is taut or slack: a taut piece next to a slack one draws cable out of it.
"""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim import cable_law
from cablesense_sim.compiled import compiled
from cablesense_sim.effects.effect import CablePull

_LEAST_GIVE_M = 1e-8


class CableChains:
    """Cables side by side, of up to K pieces; holds how their material lies in the pieces."""

    def __init__(
        self, compliance_m_n: Array, lengths_m: Array, limit: Array, share: Array,
        give_m: Array | float = 0.0, rounding: Array | float = 0.0,
    ) -> None:  # fmt: skip
        """Cables (...) whose nodes carry a share of their limit, from -1 to 1.

        Args:
            compliance_m_n: (..., K), zero for pieces beyond the end of a cable.
            lengths_m: (..., K) now. They count from any origin for which a cable is just slack
                where they add up to zero.
            limit: (..., K - 1) the limit φ of each node.
            share: (..., K - 1) of it that each carries.
            give_m: broadcast to (..., K - 1): cable that passes a node while the share grows by
                one before it slips (bristles); zero sticks rigidly.
            rounding: broadcast likewise, Dahl's exponent from 0 to below 1: bristles stiffen by
                (1 - share)^rounding / give on the way to their limit, at 0 evenly.
        """
        self._shape = np.shape(lengths_m)
        nodes = (*self._shape[:-1], self._shape[-1] - 1)
        compliance = np.broadcast_to(compliance_m_n, self._shape)
        exists = compliance > 0.0
        share, give = np.broadcast_to(share, nodes), np.broadcast_to(give_m, nodes)
        left = kept(share, limit)
        parts = compliance * np.concatenate([np.ones_like(left[..., :1]), left], axis=-1)
        whole = lengths_m.sum(-1, keepdims=True)
        parts = np.where(whole > 0.0, parts, compliance)
        natural = lengths_m - parts / parts.sum(-1, keepdims=True) * whole
        self._cables = cable_law.Cables(
            stiffness_n_m=self._flat(np.where(exists, 1.0 / np.where(exists, compliance, 1.0), 0)),
            give_m=self._flat(np.where(give > _LEAST_GIVE_M, give, 0.0)),
            rounding=self._flat(np.broadcast_to(rounding, nodes)),
            natural_m=self._flat(natural),
            share=self._flat(share),
            slips=np.zeros((natural[..., 0].size, nodes[-1])),
            passed_m=np.zeros((natural[..., 0].size, nodes[-1])),
        )

    def pull(self, lengths_m: Array, limit: Array) -> CablePull:
        """At lengths (..., K), m, and limits (..., K - 1) of now, from the state as it is."""
        tensions, slope = cable_law.pull(self._cables, self._flat(lengths_m), self._flat(limit))
        return CablePull(
            tensions.reshape(self._shape), slope.reshape(*self._shape, self._shape[-1])
        )

    def settle(self, lengths_m: Array, limit: Array) -> None:
        """Stay there. In a slack cable the material comes to lie evenly."""
        cable_law.settle(self._cables, self._flat(lengths_m), self._flat(limit))

    def _flat(self, values: Array) -> Array:
        """Values (..., K) of cables as (C, K) in one contiguous copy."""
        wide = np.broadcast_to(values, (*self._shape[:-1], values.shape[-1]))
        return np.array(wide, dtype=float, order="C").reshape(-1, values.shape[-1])


def kept(share: Array, limit: Array) -> Array:
    """Ratio (..., K - 1) of the tension behind each node to that at the actuator.

    Nodes carry a share, from -1 to 1, of their limit φ.
    """
    return np.exp(-np.cumsum(share * limit, axis=-1))


@compiled
def pulled_over_guides_n(near_n: Array, pulled_n: Array, ratio: Array, begins: Array) -> Array:
    """Tensions (R, G), N, beyond G guides in a row, while a motor holds that before the first.

    In each row the run beyond a guide is pulled by its own stretch. It slips as soon as the ratio
    of the tensions at the guide exceeds the bound. Each run is taken to be as stiff as all that
    lies beyond its guide.

    Args:
        near_n: (R,) at the motor, above zero.
        pulled_n: (R, G) by how much the tension beyond each would grow if nothing slipped.
        ratio: (R, G) exp(φ) of each guide.
        begins: (R,) 1 where a course begins, without friction, else 0.
    """
    found = np.empty(pulled_n.shape)
    for row in range(len(near_n)):
        near = near_n[row]
        for k in range(pulled_n.shape[1]):
            if begins[row] == 0.0:
                free = found[row - 1, k] + pulled_n[row, k]
                near = min(max(free, near / ratio[row, k]), near * ratio[row, k])
            found[row, k] = near
    return found
