"""A built machine whose tendons rub, from rest to rest: each rest depends on the one before.

Every straight piece of a tendon is elastic, and rubs at every site and every geom where it bends
(`cable_chain`): tensions on both sides stay within exp(±μθ) of each other, and cable passes at
that bound only. Each piece pulls at what it spans with its own tension, so there is no potential:
rest is found by Newton's method on the forces F of the coordinates,

    F = F_0(r) - Σ_s J_s' T_s,    ∂F/∂r = ∂F_0/∂r - Σ_s T_s ∂J_s/∂r - Σ_st J_s' (∂T_s/∂l_t) J_t.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.cable_chain import CableChains
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.simulated import AtRest, SimulatedMachine
from cablesense_sim.machine.statics import LinkForce, force_on
from cablesense_sim.machine.tendon_guides import RUN_COMPLIANCE
from cablesense_sim.machine.tendon_paths import TendonPaths

_SHORTEST_SHARE = 1e-3
"""Of a tendon's compliance behind its first site: pieces have no less, however short."""
_LEAST_LIMIT = 1e-6
"""Logarithm of the ratio of tensions that every bend holds: else some cables slip for ever."""
_REST = 1e-9
"""A machine is at rest where the step that is left is shorter, rad or m."""
_LONGEST_STEP = 0.02
"""Longest step, rad or m: ends of sticking are close to each other."""
_MOST_STEPS = 200
_STEPS_PER_DERIVATIVE = 10
"""Steps after which the derivative at constant tensions is taken anew."""
_LEAST_STIFFNESS = 1e-4
"""Against any motion, over that against the stiffest: where there is less, steps lead nowhere."""
_CUT = 0.5
_SMALLEST_SHARE = 1e-3
_RESTS_ON_A_WAY = 8
"""Rests by which a machine comes to the next command or load: it slides on the way."""


class _State(NamedTuple):
    """A machine at a pose (n,).

    Attributes:
        pose: (n,).
        lengths_m: (K, S) of pieces, from where a whole tendon is just slack.
        limit: (K, S - 1) of bends.
        tensions_n: (K, S).
        residual: (n,) forces that nothing balances.
        elastic_slope: (n, n) ∂F/∂r by the stretch of pieces.
    """

    pose: Array
    lengths_m: Array
    limit: Array
    tensions_n: Array
    residual: Array
    elastic_slope: Array


class QuasiStaticMachine:
    """A machine whose tendons rub; holds how they lie.

    It begins at a command with even tensions along each tendon.
    """

    def __init__(
        self,
        simulated: SimulatedMachine,
        command: Array,
        coefficient: float,
        run_compliance: float = RUN_COMPLIANCE,
    ) -> None:
        """For a coefficient of friction, at a command (C,).

        Raises:
            MachineError: it finds no rest, or its joints are measured, so that its tensions do
                not follow from commands.
        """
        machine = simulated.machine
        if machine.is_measured:
            raise MachineError(
                f"{machine.name}: friction of tendons is simulated where joints are commanded; "
                "this one states joints: measured"
            )
        self._simulated = simulated
        self._statics = simulated.built.statics
        self._paths = TendonPaths(machine, self._statics.model)
        self._coefficient = coefficient
        first = simulated.untouched(command)
        self._pose = first.pose
        self._unstretched_m = simulated.unstretched_m(command)
        self._forces: tuple[LinkForce, ...] = ()
        paths = self._paths.at(first.pose)
        compliance_m_n = self._compliance_m_n(run_compliance)
        lengths_m = paths.length_m.copy()
        lengths_m[:, 0] -= self._unstretched_m
        nodes = np.zeros_like(paths.bend_rad)
        self._chains = CableChains(compliance_m_n, lengths_m, nodes, nodes)
        state = self._rest(self._unstretched_m, ())
        self._settle(state)

    def go(self, command: Array, contacts: Sequence[LinkForce] = ()) -> AtRest:
        """At rest at a command (C,) under contacts, whose forces are along stated axes.

        Raises:
            MachineError: it finds no rest.
        """
        simulated = self._simulated
        axes = simulated.frames(command, simulated.untouched(command)).axes
        forces = [replace(one, force_n=axes[one.link] @ one.force_n) for one in contacts]
        return self.under(command, forces, _RESTS_ON_A_WAY)

    def under(self, command: Array, forces: Sequence[LinkForce], rests: int = 1) -> AtRest:
        """At rest at a command (C,) under forces in base axes, after as many rests on the way.

        Raises:
            MachineError: it finds no rest.
        """
        begun_m = self._unstretched_m
        wanted_m = self._simulated.unstretched_m(command)
        earlier = self._forces
        for share in np.linspace(0.0, 1.0, rests + 1)[1:]:
            acting = [*_scaled(earlier, 1.0 - share), *_scaled(forces, share)]
            self._settle(self._rest(begun_m + share * (wanted_m - begun_m), acting))
        self._unstretched_m = wanted_m
        self._forces = tuple(forces)
        built = self._simulated.built
        tensions_n = self._tensions_n[:, 0]
        values = tensions_n[self._simulated.machine.channels.tendon]
        return AtRest(self._pose, tensions_n, built.gain * values + built.zero)

    @property
    def pose(self) -> Array:
        """(n,) at the last rest."""
        return self._pose.copy()

    def _compliance_m_n(self, run_compliance: float) -> Array:
        """(K, S) of the pieces, by their lengths in the reference pose; the first has the run."""
        length_m = self._paths.at(self._simulated.machine.reference).length_m
        is_piece = self._paths.is_piece
        shares = length_m / length_m.sum(axis=1, keepdims=True)
        shares = np.where(is_piece, np.maximum(shares, _SHORTEST_SHARE), 0.0)
        shares /= shares.sum(axis=1, keepdims=True) * (1.0 + run_compliance)
        shares[:, 0] += run_compliance / (1.0 + run_compliance)
        return np.asarray(shares / self._statics.stiffness_n_m[:, None])

    def _settle(self, state: _State) -> None:
        self._chains.settle(state.lengths_m, state.limit)
        self._pose = state.pose
        self._tensions_n = state.tensions_n

    def _rest(self, unstretched_m: Array, forces: Sequence[LinkForce]) -> _State:
        """The next rest, by Newton's steps, cut where they lead over ends of sticking."""
        state = self._state(self._pose, unstretched_m, forces)
        for number in range(_MOST_STEPS):
            if number % _STEPS_PER_DERIVATIVE == 0:
                constant = self._statics.load_slope(state.pose, state.tensions_n[:, 0])
            step = np.linalg.solve(_stiffened(-constant - state.elastic_slope), state.residual)
            length = float(np.abs(step).max())
            if length < _REST:
                return state
            driven = float(step @ state.residual)
            share = min(1.0, _LONGEST_STEP / length)
            next_state = self._state(state.pose + share * step, unstretched_m, forces)
            while share > _SMALLEST_SHARE and float(step @ next_state.residual) < -_CUT * driven:
                share *= _CUT
                next_state = self._state(state.pose + share * step, unstretched_m, forces)
            state = next_state
        raise MachineError(
            f"{self._simulated.machine.name}: finds no rest with friction; lower the forces or "
            "the coefficient"
        )

    def _state(self, pose: Array, unstretched_m: Array, forces: Sequence[LinkForce]) -> _State:
        paths = self._paths.at(pose)
        lengths_m = paths.length_m.copy()
        lengths_m[:, 0] -= unstretched_m
        limit = np.maximum(self._coefficient * paths.bend_rad, _LEAST_LIMIT)
        pull = self._chains.pull(lengths_m, limit)
        slope_m = paths.slope_m
        residual = self._statics.at(pose).load - np.einsum("ks,ksi->i", pull.tensions_n, slope_m)
        if forces:
            frames = self._statics.links()
            residual = residual + sum(force_on(frames, force) for force in forces)
        by_pose = pull.by_length_n_m @ slope_m
        elastic_slope = -np.einsum("ksi,ksj->ij", slope_m, by_pose)
        return _State(pose, lengths_m, limit, pull.tensions_n, residual, elastic_slope)


def _stiffened(stiffness: Array) -> Array:
    """(n, n) a stiffness, with as much added as makes it resist every motion."""
    resisted = np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T))
    least = _LEAST_STIFFNESS * resisted[-1]
    return np.asarray(stiffness + max(least - resisted[0], 0.0) * np.eye(len(stiffness)))


def _scaled(forces: Sequence[LinkForce], share: float) -> list[LinkForce]:
    return [replace(force, force_n=share * force.force_n) for force in forces]
