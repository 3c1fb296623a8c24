"""Whether tension differences are those of any force on the arm: what the networks do not tell.

Contact torques τ turn the joints by H⁻¹ τ, and the differences of taut cables are K J H⁻¹ τ. Of M
differences all but 2N combinations are zero but for noise. What is beyond that is no contact, and
no network sees it. A cable that is slack under the contact says nothing here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import transmissions
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.kinematics import cable_jacobian_m
from cablesense_sim.replay import difference_variance_n2

_NOISE_STD = 5.0
"""Standard deviations of a difference that noise may leave, and"""
_NONLINEAR_SHARE = 0.2
"""share of the differences that large turns may leave."""
_FRICTION_SHARE = 0.5
"""The same of an arm whose file lists friction or creep: cables then carry other shares."""
_SLACK_SHARE = 0.1
"""Share of a cable's tension without a contact, up to which it may be slack."""


class ContactSubspace:
    """The tension differences that forces on an arm can make."""

    def __init__(self, arm: Arm, tare_samples: int) -> None:
        self._mechanism = mechanism_of(arm)
        self._std_n = difference_variance_n2(arm.sensors, tare_samples) ** 0.5
        self._share = _FRICTION_SHARE if transmissions([entries_of(arm)]) else _NONLINEAR_SHARE

    def judged(self, differences_n: Array, commands_rad: Array) -> tuple[Array, NDArray[np.bool_]]:
        """(B,) RMS of differences (B, M) that no force makes, and whether each is little enough.

        Commands are (B, 2N).
        """
        size_n = np.sqrt((differences_n**2).mean(axis=1))
        allowed_n = _NOISE_STD * self._std_n + self._share * size_n
        misfit_n = self._misfit_n(differences_n, commands_rad, np.ones_like(differences_n))
        far = np.flatnonzero(misfit_n > allowed_n)
        if far.size:
            taut = self._taut(differences_n[far], commands_rad[far])
            misfit_n[far] = self._misfit_n(differences_n[far], commands_rad[far], taut)
        return misfit_n, np.asarray(misfit_n <= allowed_n)

    def _misfit_n(self, differences_n: Array, commands_rad: Array, taut: Array) -> Array:
        jacobian_m = cable_jacobian_m(self._mechanism, commands_rad)
        by_turn_n = taut[:, :, None] * self._mechanism.stiffness_n_m[:, None] * jacobian_m
        basis, _ = np.linalg.qr(by_turn_n)
        of_taut_n = taut * differences_n
        coordinates = np.einsum("bmj,bm->bj", basis, of_taut_n)
        left_n = of_taut_n - np.einsum("bmj,bj->bm", basis, coordinates)
        return np.asarray(np.sqrt((left_n**2).mean(axis=1)))

    def _taut(self, differences_n: Array, commands_rad: Array) -> Array:
        """(B, M) one for cables that are taut; all of them where the arm finds no rest."""
        try:
            unloaded_n = solve_equilibrium(self._mechanism, commands_rad).tensions_n
        except EquilibriumError:
            return np.ones_like(differences_n)
        left_n = unloaded_n + differences_n
        least_n = _NOISE_STD * self._std_n + _SLACK_SHARE * unloaded_n
        return np.asarray((left_n > least_n).astype(float))
