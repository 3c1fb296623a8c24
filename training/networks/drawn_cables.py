"""What the commands of the past have left in cables that rub, told by the commands alone.

A stop operator follows the cable that is drawn, in units of its give, and stops at -1 and 1
(Visintin, Differential Models of Hysteresis, 1994, chapter III): the share of its largest friction
that a guide holds where only the drawing moves the cable.
"""

from __future__ import annotations

import torch
from torch import Tensor

from cablesense_training.inference.temporal_state import TemporalState

GIVES_M = (2e-5, 2e-4, 2e-3)
"""Lengths of cable drawn from the middle of a stop operator to its end."""


class DrawnCables:
    """Follows set-points; the past is the part of a `TemporalState` behind the hidden one."""

    def __init__(self, cables: int, joints: int, hidden: int) -> None:
        self.layout = TemporalState(hidden, cables * len(GIVES_M), cables, joints)
        self._parts = self.layout.parts[1:]

    @property
    def size(self) -> int:
        """Of the past (…, size)."""
        return sum(self._parts)

    def follow(self, past: Tensor, lengths_m: Tensor, set_point_rad: Tensor) -> Tensor:
        """The past (B, size) one tick later, at cable lengths (B, M) and a set-point (B, 2N)."""
        shares, lengths, _, shares_tared, set_point_tared, known = past.split(self._parts, dim=-1)
        drawn = (lengths_m - lengths) * known
        gives = lengths_m.new_tensor(GIVES_M)
        shares = (shares + (drawn[..., None] / gives).flatten(-2)).clamp(-1.0, 1.0)
        now_known = torch.ones_like(known)
        return torch.cat(
            [shares, lengths_m, set_point_rad, shares_tared, set_point_tared, now_known], dim=-1
        )

    def tared(self, past: Tensor) -> Tensor:
        """The past (B, size) right after a tare."""
        shares, lengths, set_point, _, _, known = past.split(self._parts, dim=-1)
        return torch.cat([shares, lengths, set_point, shares, set_point, known], dim=-1)

    def seen(self, past: Tensor) -> Tensor:
        """What a network is shown of a past: shares now and at the tare, set-point at the tare."""
        shares, _, _, shares_tared, set_point_tared, _ = past.split(self._parts, dim=-1)
        return torch.cat([shares, shares_tared, _PER_RAD * set_point_tared], dim=-1)

    @property
    def seen_size(self) -> int:
        """Of what `seen` gives."""
        return 2 * self.layout.shares + self.layout.joints


_PER_RAD = 10.0
"""Brings set-points to the size of the shares."""
