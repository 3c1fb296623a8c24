"""LuGre's friction of a joint: bristles that bend and slip, with less friction the faster they go.

    z' = v - |v| z / (p γ),    torque = coulomb (z + τ z') / p,    γ = (1 + s e^-(v/v_s)²) (1 ± d)

z is the bend of the bristles, p by how much they bend until they slip, s Stribeck's share, d the
difference between both ways (Canudas de Wit et al., IEEE Trans. Autom. Control 40(3), 1995).
Without s and d, and with τ = 0, it is Dahl's law; with p near zero it is Stribeck's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablesense_base import Array
from cablesense_plants.cases import NO_FAULT

_CREEP_RAD_S = 0.01
"""Speed at which friction without its past has turned round."""


@dataclass(frozen=True)
class Bristles:
    """Numbers of the law by joint (N,), or (B, N) of several robots.

    Attributes:
        coulomb_n_m: friction of fast motion, forwards and backwards on average.
        static_share: by how much more it is at rest, as a share.
        stribeck_rad_s: speed at which that has fallen to 1/e.
        presliding_rad: by how much bristles bend until they slip.
        damping_s: time by which bending is damped.
        lopsided: by how much more it is forwards than on average, as a share.
    """

    coulomb_n_m: Array = NO_FAULT
    static_share: Array = NO_FAULT
    stribeck_rad_s: Array = NO_FAULT + 0.1
    presliding_rad: Array = NO_FAULT + 1e-3
    damping_s: Array = NO_FAULT
    lopsided: Array = NO_FAULT

    def slipping(self, speed: Array) -> Array:
        """Bend of bristles that slip at a speed, by that of fast motion."""
        more = self.static_share * np.exp(-((speed / self.stribeck_rad_s) ** 2))
        return np.asarray((1.0 + more) * (1.0 + self.lopsided * np.sign(speed)))

    @property
    def stiffness_n_m_rad(self) -> Array:
        """Of bristles that do not slip."""
        return np.asarray(self.coulomb_n_m / self.presliding_rad)

    def steady_n_m(self, speed: Array) -> Array:
        """Torque against the motion at a steady speed."""
        return np.asarray(self.coulomb_n_m * self.slipping(speed) * np.tanh(speed / _CREEP_RAD_S))

    def stepped(self, bend: Array, speed: Array, step_s: float) -> tuple[Array, Array]:
        """The bend, by that of fast motion, after a step at a speed, and the torque meanwhile."""
        slips_at = self.slipping(speed) * np.sign(speed)
        way = np.abs(speed) * step_s
        stays = np.exp(-way / (self.presliding_rad * np.maximum(np.abs(slips_at), 1e-9)))
        bent = slips_at + (bend - slips_at) * stays
        torque = self.coulomb_n_m * (bent + self.damping_s * (bent - bend) / step_s)
        return bent, np.asarray(torque)


NO_BRISTLES = Bristles()
