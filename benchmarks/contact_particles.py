"""A contact particle filter, as a baseline for contacts anywhere.

Manuelli and Tedrake, Localizing External Contact Using Proprioceptive Sensors: The Contact
Particle Filter, IROS 2016. A particle is a place on a segment. Its weight is the likelihood of the
torques under the force that fits them best there; the paper's quadratic programme has the solution
of least squares here, as forces act on the axis in any direction. Particles are drawn anew by
their weights and diffuse along the arm, less from round to round.
"""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.contact_location import AXIAL_STD_N, TorqueBalance
from cablesense_training.evaluation.anywhere import LocatedContacts

PARTICLES, ROUNDS = 200, 12
_FIRST_STEP, _LAST_STEP = 0.2, 1e-3
"""Diffusion in the first and in the last round, as shares of a segment's reach."""
_ROWS_AT_ONCE = 1000


def contact_particles(
    balance: TorqueBalance, reach: Array, rng: np.random.Generator
) -> LocatedContacts:
    """The contacts that the filter finds from the balance of B samples, within a reach (N, 2)."""
    count = len(balance.torque_n_m)
    rows = [slice(at, at + _ROWS_AT_ONCE) for at in range(0, count, _ROWS_AT_ONCE)]
    parts = [_filtered(TorqueBalance(*(part[at] for part in balance)), reach, rng) for at in rows]
    return LocatedContacts(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _filtered(
    balance: TorqueBalance, reach: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array, Array, Array]:
    count, segments = balance.by_place.shape[:2]
    torques = np.concatenate([balance.by_force_m, balance.by_place], axis=2)
    weighted = torques @ balance.precision[:, None]
    gram = weighted @ np.swapaxes(torques, 2, 3)
    pull = (weighted @ balance.torque_n_m[:, None, :, None])[..., 0]
    every = np.arange(count)[:, None]
    n = np.tile(np.arange(PARTICLES) % segments, (count, 1))
    low, high = reach.T
    place_m = low[n] + (high - low)[n] * rng.random(n.shape)
    for step in np.geomspace(_FIRST_STEP, _LAST_STEP, ROUNDS):
        gain, _ = _fitted(gram[every, n], pull[every, n], place_m)
        weight = np.exp(0.5 * (gain - gain.max(axis=1, keepdims=True)))
        ends = np.cumsum(weight, axis=1) / weight.sum(axis=1, keepdims=True)
        combs = (np.arange(PARTICLES) + rng.random((count, 1))) / PARTICLES
        drawn = (ends[:, None] < combs[..., None]).sum(axis=2).clip(max=PARTICLES - 1)
        n = n[every, drawn]
        moved = step * (high - low)[n] * rng.normal(size=n.shape)
        place_m = np.clip(place_m[every, drawn] + moved, low[n], high[n])
    gain, force_n = _fitted(gram[every, n], pull[every, n], place_m)
    share = np.stack([(n == k).mean(axis=1) for k in range(segments)], axis=1)
    best = share.argmax(axis=1)
    # the particles of the likeliest segment, by their weights
    own = np.where(n == best[:, None], 0.5 * gain, -np.inf)
    weight = np.exp(own - own.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    normal_n = np.linalg.norm(force_n[..., 1:], axis=-1)
    return (
        best + 1,
        (weight * place_m).sum(axis=1),
        (weight[..., None] * force_n).sum(axis=1),
        (weight * place_m * normal_n).sum(axis=1),
        _interval(place_m, weight),
        _interval(normal_n, weight),
    )


def _fitted(gram: Array, pull: Array, place_m: Array) -> tuple[Array, Array]:
    """Gains (B, P) in chi², and forces (B, P, 3), that fit best at places (B, P)."""
    s = place_m[..., None, None]
    across = gram[..., :3, 3:] + gram[..., 3:, :3]
    information = gram[..., :3, :3] + s * across + s * s * gram[..., 3:, 3:]
    information[..., 0, 0] += AXIAL_STD_N**-2
    pulled = pull[..., :3] + place_m[..., None] * pull[..., 3:]
    force_n = np.linalg.solve(information, pulled[..., None])[..., 0]
    return np.asarray((force_n * pulled).sum(axis=-1)), np.asarray(force_n)


def _interval(values: Array, weight: Array) -> Array:
    """(B, 2) quantiles 2.5 % and 97.5 % of weighted particles (B, P)."""
    order = np.argsort(values, axis=1)
    ordered = np.take_along_axis(values, order, axis=1)
    below = np.cumsum(np.take_along_axis(weight, order, axis=1), axis=1)
    at = [(below < share).sum(axis=1).clip(max=values.shape[1] - 1) for share in (0.025, 0.975)]
    return np.take_along_axis(ordered, np.stack(at, axis=1), axis=1)
