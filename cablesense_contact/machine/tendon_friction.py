"""What friction makes of a tendon's tension, from its actuator on, by what it carries at guides.

At guide g, where a tendon turns by the angle w, the tensions have the ratio exp(ε w) towards its
end (ε the carried friction). With ρ_p the tension of piece p over that at the actuator, with the
pieces' moments J_p and their shares c_p of the compliance, a tension T at the actuator

    pulls with T Σ_p ρ_p J_p,    stretches the tendon by T / k Σ_p c_p ρ_p,

and the derivatives by what guide g carries are those sums over the pieces behind it, times w.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.tendon_guides import RUN_COMPLIANCE, GuidesAtPose, TendonGuides


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


class TendonFriction:
    """The friction of the M tendons of a machine that are read.

    Attributes:
        guides: where they run.
        compliance_share: (M, G + 1) of the pieces.
    """

    def __init__(self, machine: Machine) -> None:
        self.guides = TendonGuides(machine)
        self._tendons = len(machine.tendons.ids)
        self.compliance_share = self.guides.length_share / (1.0 + RUN_COMPLIANCE)
        self.compliance_share[:, 0] += RUN_COMPLIANCE / (1.0 + RUN_COMPLIANCE)

    def at(self, pose: Array, carried: Array) -> Carried:
        """At a pose (n,), with what is carried (G M,), M at each guide."""
        there = self.guides.at(pose)
        per_guide = carried.reshape(there.wrap_rad.T.shape).T
        ratio = np.ones_like(there.length_m)
        ratio[:, 1:] = np.exp(np.cumsum(per_guide * there.wrap_rad, axis=1))
        pulls_m = ratio[..., None] * there.slope_m
        stretched = ratio * self.compliance_share
        even = stretched.sum(axis=1, keepdims=True)
        by_carried = _behind(stretched[..., None], there)[..., 0] / even

        # those that are read come first
        read = len(ratio)
        beside_m = np.zeros((self._tendons, len(pose)))
        beside_m[:read] = pulls_m.sum(axis=1) - there.slope_m.sum(axis=1)
        stretch = np.ones(self._tendons)
        stretch[:read] = even[:, 0]
        return Carried(
            beside_m=beside_m,
            stretch=stretch,
            moment_by_carried_m=_behind(pulls_m, there).swapaxes(0, 1),
            stretch_by_carried=by_carried.T,
        )


def _behind(of_pieces: Array, there: GuidesAtPose) -> Array:
    """(M, G, ...) sums over the pieces behind each guide, times the angle there."""
    behind = of_pieces[:, :0:-1].cumsum(axis=1)[:, ::-1]
    return np.asarray(there.wrap_rad[..., None] * behind)
