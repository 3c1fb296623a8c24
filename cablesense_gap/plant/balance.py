"""The balance of an arm that rubs: of each piece of cable, and of the torques on the joints."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.plant.body import Body
from cablesense_gap.plant.geometry import cable_lengths_m, spans, turns
from cablesense_gap.plant.rest import add_blocks, cable_torques
from cablesense_gap.plant.rubbing import Rubbing, piece_compliance_m_n
from cablesense_gap.plant.slip import follow
from cablesense_gap.plant.state import State
from cablesense_gap.plant.torques import torques

Array = NDArray[np.float64]

_ENOUGH_NM, _ENOUGH_N = 1e-7, 1e-6


class Balance(NamedTuple):
    """What is out of balance at a guess, and its derivatives; P = 2J + 2 pieces of cable.

    Attributes:
        torque_nm: (2J,) left on the joint angles.
        torque_slope: (2J, 2J) its derivative with the cables' tensions held.
        misfit_n: (M, P) of each cable: its stretch, then the slip law at every guide.
        by_tension: (M, P, P) its derivative by the cable's tensions.
        by_angle: (M, P, 2J) its derivative by the angles.
        pull: (2J, M, P) torque by tension.
        rub: (P - 1, M) what the state of friction at the guides would become.
        fed_m: (P - 1, M) cable that would have passed the guides.
        joint_rub: (2J,) what the state of friction in the joints would become.
    """

    torque_nm: Array
    torque_slope: Array
    misfit_n: Array
    by_tension: Array
    by_angle: Array
    pull: Array
    rub: Array
    fed_m: Array
    joint_rub: Array

    @property
    def settled(self) -> bool:
        """Whether this is rest."""
        return bool(
            np.abs(self.torque_nm).max() < _ENOUGH_NM and np.abs(self.misfit_n).max() < _ENOUGH_N
        )

    def condensed(self) -> tuple[Array, Array, Array]:
        """Torque (2J,), slope (2J, 2J) once cables follow, and how they do (M, 2J + 2, 1 + 2J)."""
        sides = np.concatenate([self.misfit_n[..., None], self.by_angle], axis=-1)
        answer = -np.linalg.solve(self.by_tension, sides)
        pulled = np.einsum("acp,cpb->ab", self.pull, answer)
        return self.torque_nm - pulled[:, 0], self.torque_slope - pulled[:, 1:], answer


class Balances:
    """Balances of one arm.

    A cable is cut at its guides: the piece at the sensor, the run, then by joint the piece across
    it and the piece inside its segment. Guides lie between: a pulley, and the plates.
    """

    def __init__(self, body: Body, rubbing: Rubbing, run_m: float) -> None:
        """Of a body that rubs, with the run before its base plate."""
        joints = body.joint_count
        self.body, self.rubbing = body, rubbing
        self.compliance_m_n = piece_compliance_m_n(body, run_m, rubbing.spread)
        self.straight_m = cable_lengths_m(body, np.zeros((1, 2 * joints)))[0]
        self.distal = np.zeros((2 * joints + 1, joints))
        self.distal[0] = 1.0
        self.distal[1::2] = np.triu(np.ones((joints, joints)))
        self.distal[2::2] = np.triu(np.ones((joints, joints)), 1)
        self.across = 2 * np.arange(joints) + 2
        self.of_joint = np.repeat(np.arange(joints), 2)

    def fed_m(self, length_m: Array, tension_n: Array) -> Array:
        """(P - 1, M) unstretched cable beyond each guide, of spans (J, M) and tensions (P, M)."""
        stretched = np.cumsum((self.compliance_m_n * tension_n)[::-1], axis=0)[::-1][1:]
        return self.distal @ length_m - stretched

    def at(
        self, state: State, angles: Array, tension: Array, wanted_m: Array, loads_n: Array
    ) -> Balance:
        """The balance at angles (2J,) and tensions (P, M), after a state.

        `wanted_m` (M,) is the unstretched cable that the spans have, `loads_n` (N, 3) the loads.
        """
        body, rubbing = self.body, self.rubbing
        turning = turns(body, angles[None])
        across = spans(body, angles[None], turning, with_bends=True)
        length, slope = across.length_m[0], across.slope_m_rad[0].reshape(len(angles), -1)
        bends = across.bend_rad[0].reshape(len(angles), -1)
        pulley = np.full((1, body.cable_count), rubbing.pulley_rad)
        grip = rubbing.coefficient * np.concatenate([pulley, bends])
        fed = self.fed_m(length, tension)
        rub, rub_slope = follow(rubbing.onset, state.rub, fed - state.fed_m, rubbing.reach_m)
        taut = tension > 0.0
        gained = np.where(taut[:-1], np.expm1(grip * rub), 0.0)
        carried = tension[:-1] * (1.0 + gained)
        sticking = carried * grip * rub_slope * taut[:-1]

        pieces = len(tension)
        stiff, c = body.stiffness_n_m, self.compliance_m_n
        misfit = np.empty((body.cable_count, pieces))
        strain = (c * (tension - body.pretension_n)).sum(axis=0)
        misfit[:, 0] = stiff * (strain - length.sum(axis=0) + wanted_m)
        misfit[:, 1:] = (tension[1:] - carried).T

        by_tension = np.zeros((body.cable_count, pieces, pieces))
        by_tension[:, 1:] = np.triu(np.ones((pieces, pieces)))[1:] * c.T[:, None, :]
        by_tension[:, 1:] *= sticking.T[:, :, None]
        by_tension[:, 0] = (stiff * c).T
        guide = np.arange(1, pieces)
        by_tension[:, guide, guide] += 1.0
        by_tension[:, guide, guide - 1] -= (1.0 + gained).T

        by_angle = np.empty((body.cable_count, pieces, len(angles)))
        by_angle[:, 0] = -stiff[:, None] * slope.T
        by_angle[:, 1:] = -(
            sticking.T[:, :, None] * self.distal[:, self.of_joint] * slope.T[:, None, :]
        )

        pulling = np.maximum(tension[self.across], 0.0)
        torque, blocks = cable_torques(across.slope_m_rad, across.curve_m_rad2, pulling[None])
        outer = torques(body, angles[None], turning, loads_n[None])
        matrix = add_blocks(outer.slope_nm_rad, blocks)[0]
        joint_rub, joint_nm, joint_slope = self._joints(state, angles)
        matrix[np.arange(len(angles)), np.arange(len(angles))] -= joint_slope

        pull = np.zeros((len(angles), body.cable_count, pieces))
        own = self.across[self.of_joint]
        pull[np.arange(len(angles)), :, own] = slope * taut[own]
        return Balance(
            (torque + outer.torque_nm)[0] - joint_nm,
            matrix,
            misfit,
            by_tension,
            by_angle,
            pull,
            rub,
            fed,
            joint_rub,
        )

    def _joints(self, state: State, angles: Array) -> tuple[Array, Array, Array]:
        rubbing = self.rubbing
        speed = np.abs(state.speed_rad_s) / rubbing.speed_rad_s
        level = rubbing.joint_nm.ravel() * (1.0 + (rubbing.breakaway - 1.0) * np.exp(-(speed**2)))
        moved = angles - state.angles_rad
        new, slope = follow(rubbing.joint_onset, state.joint_rub, moved, rubbing.joint_reach_rad)
        return new, level * new, level * slope
