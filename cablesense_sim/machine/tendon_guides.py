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


class TendonGuides:
    """The guides of the M tendons of a machine that are read, in the order of their sensors.

    Attributes:
        exists: (G, M) whether a tendon can bend at a guide.
        length_share: (M, G + 1) of the pieces in the length in the reference pose.
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
        self._guide_of = _one_hot(spans_passed[:, :-1], guides) * is_node[..., None]
        self.exists: NDArray[np.bool_] = self._guide_of.any(axis=1).T
        length_m = self.at(machine.reference).length_m
        self.length_share = length_m / length_m.sum(axis=1, keepdims=True)

    def at(self, pose: Array) -> GuidesAtPose:
        """The guides at a pose (n,)."""
        paths = self._paths.at(pose)
        return GuidesAtPose(
            length_m=np.einsum("ks,ksp->kp", paths.length_m[self._read], self._piece_of),
            slope_m=np.einsum("ksn,ksp->kpn", paths.slope_m[self._read], self._piece_of),
            wrap_rad=np.einsum("ks,ksg->kg", paths.bend_rad[self._read], self._guide_of),
        )


def _one_hot(numbers: NDArray[np.int64], count: int) -> Array:
    """(..., count) 1 at each number, none where it is not below the count."""
    return (numbers[..., None] == np.arange(count)).astype(float)
