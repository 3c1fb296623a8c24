"""What friction makes of a tendon's tension, from its actuator on, by what it carries at guides.

Where a tendon turns by the angle w at guide g, the tensions have the ratio exp(ε_g w) towards its
end (ε the carried friction). With ρ_s the tension of straight piece s over that at the actuator,
the pieces' moments J_s and their shares c_s of the compliance, a tension T at the actuator

    pulls with T Σ_s ρ_s J_s,    stretches the tendon by T / k Σ_s c_s ρ_s,

and the derivatives by ε_g are those sums with each piece times w_gs, by which the tendon has
turned at the guide before it: ρ_s = exp(Σ_g ε_g w_gs).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.tendon_guides import RUN_COMPLIANCE, TendonGuides


class Carried(NamedTuple):
    """M tendons over G guides, with n coordinates, at a pose.

    Attributes:
        beside_m: (K, n) moments of all K tendons beyond those of even tensions.
        stretch: (K,) by that of an even tension.
        moment_by_carried_m: (G, M, n) derivatives of the moments, and
        stretch_by_carried: (G, M) of the logarithm of the stretch, by what is carried.
    """

    beside_m: Array
    stretch: Array
    moment_by_carried_m: Array
    stretch_by_carried: Array


class CarriedTendonFriction:
    """The friction of the M tendons of a machine that are read.

    Attributes:
        guides: where they run.
        compliance_share: (M, G + 1) of the pieces.
    """

    def __init__(self, machine: Machine) -> None:
        self.guides = TendonGuides(machine)
        self._tendons = len(machine.tendons.ids)
        behind = 1.0 / (1.0 + RUN_COMPLIANCE)
        self._run_share = 1.0 - behind
        self._straight_share = behind * self.guides.straight_share
        self.compliance_share = behind * self.guides.length_share
        self.compliance_share[:, 0] += self._run_share

    def at(self, pose: Array, carried: Array) -> Carried:
        """At a pose (n,), with what is carried (G M,), M at each guide."""
        there = self.guides.turns(pose)
        guides = there.turned_rad.shape[-1]
        per_guide = carried.reshape(guides, -1).T
        ratio = np.exp(np.einsum("ksg,kg->ks", there.turned_rad, per_guide))
        pulls_m = ratio[..., None] * there.slope_m
        stretched = ratio * self._straight_share
        even = self._run_share + stretched.sum(axis=1)
        by_carried = np.einsum("ks,ksg->gk", stretched, there.turned_rad) / even

        # those that are read come first
        read = len(ratio)
        beside_m = np.zeros((self._tendons, len(pose)))
        beside_m[:read] = pulls_m.sum(axis=1) - there.slope_m.sum(axis=1)
        stretch = np.ones(self._tendons)
        stretch[:read] = even
        return Carried(
            beside_m=beside_m,
            stretch=stretch,
            moment_by_carried_m=np.einsum("ksn,ksg->gkn", pulls_m, there.turned_rad),
            stretch_by_carried=by_carried,
        )
