"""Cables over guides in a row: pieces with friction between them, and pulls against a motor."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.compiled import compiled

_LOCKED = 3.0  # no cable reaches a ratio of tensions of exp(3) at one guide before it breaks


@compiled
def along_guides(
    spans_m: Array,
    bends_rad: Array,
    slack_m: Array,
    evenly: Array,
    longer_m: Array,
    coefficient: Array,
    pulley_wrap_rad: Array,
    guide_wrap_rad: Array,
) -> tuple[Array, Array]:
    """Lengths (P, M, 1 + 2N) of the pieces of cables, m, and limits (P, M, 2N) of their nodes.

    The nodes are the pulley at the actuator and the guide plates before and behind each joint, but
    behind the last. Lengths count from where a whole cable is just slack.

    Args:
        spans_m: (P, M, N) of cable between the plates of a joint.
        bends_rad: (P, M, N, 2) turn of a cable at the guides before and behind a joint.
        slack_m: (P, M) sum of the spans at which a cable is just slack.
        evenly: (P, M, 1 + 2N) shares of the pieces in a cable's gain of length.
        longer_m: (P, M) that gain.
        coefficient: (P, M) of friction.
        pulley_wrap_rad: (P,) wrap angle at the actuator's pulley.
        guide_wrap_rad: (P,) wrap angle at the guides between two joints with the arm straight.
    """
    arms, cables, joints = spans_m.shape
    lengths = np.zeros(evenly.shape)
    limit = np.empty((arms, cables, 2 * joints))
    for p in range(arms):
        half = 0.5 * guide_wrap_rad[p]
        for m in range(cables):
            friction = coefficient[p, m]
            lengths[p, m, 0] = -slack_m[p, m]
            limit[p, m, 0] = min(friction * pulley_wrap_rad[p], _LOCKED)
            for n in range(joints):
                before, behind = bends_rad[p, m, n]
                lengths[p, m, 2 * n + 2] = spans_m[p, m, n]
                wrap = before + half if n > 0 else before
                limit[p, m, 2 * n + 1] = min(friction * wrap, _LOCKED)
                if n + 1 < joints:
                    limit[p, m, 2 * n + 2] = min(friction * (behind + half), _LOCKED)
            for k in range(2 * joints + 1):
                lengths[p, m, k] -= evenly[p, m, k] * longer_m[p, m]
    return lengths, limit


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
    tensions_n = np.empty(pulled_n.shape)
    for row in range(len(near_n)):
        near = near_n[row]
        for k in range(pulled_n.shape[1]):
            if begins[row] == 0.0:
                free = tensions_n[row - 1, k] + pulled_n[row, k]
                near = min(max(free, near / ratio[row, k]), near * ratio[row, k])
            tensions_n[row, k] = near
    return tensions_n
