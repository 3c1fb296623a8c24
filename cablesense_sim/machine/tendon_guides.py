"""The guides of tendons: all bends between two spans that the machine moves, taken together.

A span goes from one body to another that moves by itself; only its length changes. Guide g of a
tendon is what it bends over before its span g, and is seen as one: what passes one of these bends
has passed them all. Piece 0 is what lies before the first span, piece g + 1 is span g with what
lies behind it on the same body.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.tendon_paths import TendonPaths

RUN_COMPLIANCE = 0.5
"""Of what lies before a tendon's first site, over that behind it: drive, sensor, a short piece."""


class GuidesAtPose(NamedTuple):
    """M tendons over G guides at a pose, zero beyond the last guide of a tendon.

    Attributes:
        length_m: (M, G + 1) of the pieces.
        slope_m: (M, G + 1, n) ∂length/∂r.
        wrap_rad: (M, G) by which a tendon turns at a guide.
    """

    length_m: Array
    slope_m: Array
    wrap_rad: Array


class TurnsAtPose(NamedTuple):
    """M tendons of up to S straight pieces over G guides at a pose.

    Attributes:
        slope_m: (M, S, n) ∂length/∂r of the straight pieces.
        turned_rad: (M, S, G) by which a tendon has turned at each guide before a straight piece.
    """

    slope_m: Array
    turned_rad: Array


class TendonGuides:
    """The guides of the M tendons of a machine that are read, in the order of their sensors.

    Attributes:
        exists: (G, M) whether a tendon can bend at a guide.
        straight_share: (M, S) of the straight pieces in the length in the reference pose, and
        length_share: (M, G + 1) of the pieces that `at` has.
    """

    def __init__(self, machine: Machine, model: mujoco.MjModel | None = None) -> None:
        """Of the machine as its model, or as another one of the same structure."""
        self._paths = TendonPaths(machine, model)
        self._read = machine.channels.tendon[machine.channels.tendon >= 0]
        crosses = self._paths.crosses[self._read]
        is_piece = self._paths.is_piece[self._read]
        spans_passed = crosses.cumsum(axis=1)
        spans = spans_passed[:, -1:]
        guides = int(spans.max(initial=0))
        self._piece_of = _one_hot(spans_passed, guides + 1) * is_piece[..., None]
        is_node = is_piece[:, 1:] & is_piece[:, :-1] & (spans_passed[:, :-1] < spans)
        # what lies behind the last span stretches only: it slides as the last guide does
        last = np.minimum(spans_passed[:, :-1], np.maximum(spans - 1, 0))
        is_bend = is_piece[:, 1:] & is_piece[:, :-1]
        self._slides_with = _one_hot(last, guides) * is_bend[..., None]
        self._guide_of = _one_hot(spans_passed[:, :-1], guides) * is_node[..., None]
        self.exists: NDArray[np.bool_] = self._guide_of.any(axis=1).T
        length_m = self._paths.at(machine.reference).length_m[self._read]
        self.straight_share = _shares(length_m, is_piece)
        self.length_share = np.einsum("ks,ksp->kp", self.straight_share, self._piece_of)

    def at(self, pose: Array) -> GuidesAtPose:
        """The guides at a pose (n,)."""
        paths = self._paths.at(pose)
        return GuidesAtPose(
            length_m=np.einsum("ks,ksp->kp", paths.length_m[self._read], self._piece_of),
            slope_m=np.einsum("ksn,ksp->kpn", paths.slope_m[self._read], self._piece_of),
            wrap_rad=np.einsum("ks,ksg->kg", paths.bend_rad[self._read], self._guide_of),
        )

    def turns(self, pose: Array) -> TurnsAtPose:
        """How tendons have turned up to each of their straight pieces, at a pose (n,)."""
        paths = self._paths.at(pose)
        by_guide = paths.bend_rad[self._read][..., None] * self._slides_with
        turned_rad = np.zeros((*self.straight_share.shape, by_guide.shape[-1]))
        turned_rad[:, 1:] = by_guide.cumsum(axis=1)
        return TurnsAtPose(paths.slope_m[self._read], turned_rad)


def _shares(length_m: Array, is_piece: NDArray[np.bool_]) -> Array:
    """(M, S) of pieces in the lengths of their tendons, which are even where a length is zero.

    That of a tendon that joints alone define is zero where they are, and it has one piece.
    """
    whole_m = length_m.sum(axis=1, keepdims=True)
    even = is_piece / is_piece.sum(axis=1, keepdims=True)
    has_length = whole_m != 0.0
    return np.where(has_length, length_m / np.where(has_length, whole_m, 1.0), even)


def _one_hot(numbers: NDArray[np.int64], count: int) -> Array:
    """(..., count) 1 at each number, none where it is not below the count."""
    return (numbers[..., None] == np.arange(count)).astype(float)
