"""Friction and creep of an arm: parameters and laws.

Dry friction is a state between -1 and 1 that follows a sliding distance and is kept at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.plant.body import Body

_ACTUATOR_SHARE = 0.3
"""Part of a cable's compliance that is its actuator's, where the rest is spread."""


class Onset(StrEnum):
    """How friction builds up before it slides."""

    SHARP = "sharp"
    ROUNDED = "rounded"


def friction_state(onset: Onset, state: Array, moved: Array, reach: float) -> tuple[Array, Array]:
    """New state and its derivative by the distance moved since the state was left.

    Sharp friction is a spring of `reach` that then slides (Prandtl 1928); rounded friction nears
    its full value as exp(-moved / reach) (Dahl 1968). Neither depends on time: what does not
    move keeps its state.
    """
    if onset is Onset.SHARP:
        free = state + moved / reach
        return np.clip(free, -1.0, 1.0), (np.abs(free) < 1.0) / reach
    full = np.sign(moved)
    remaining = (full - state) * np.exp(-np.abs(moved) / reach)
    new = np.where(moved == 0.0, state, full - remaining)
    slope = np.where(moved == 0.0, 1.0, np.abs(remaining)) / reach
    return new, slope


@dataclass(frozen=True)
class Friction:
    """Friction of M cables and J joints.

    Attributes:
        coefficient: (M,) of each cable on its guides.
        pulley_rad: constant wrap on a pulley at the actuator, behind the sensor.
        onset: of the cables' friction.
        reach_m: sliding over which it builds up.
        spread: whether cables stretch all along, or at their run alone.
        joint_nm: (J, 2) torque of the joints' friction while they turn.
        joint_onset: how it builds up.
        joint_reach_rad: over which angle.
        breakaway: friction of a joint at rest, by that of a turning one (Stribeck).
        speed_rad_s: over which that decays.
    """

    coefficient: Array
    pulley_rad: float
    onset: Onset
    reach_m: float
    spread: bool
    joint_nm: Array
    joint_onset: Onset
    joint_reach_rad: float
    breakaway: float
    speed_rad_s: float

    @property
    def any(self) -> bool:
        """Whether there is any."""
        return bool(self.coefficient.any() or self.joint_nm.any())


@dataclass(frozen=True)
class Creep:
    """Kelvin-Voigt elements in series with the cables, K of them.

    Attributes:
        compliance_m_n: (K, M) each one's lengthening when it has settled.
        time_s: (K,) in which it does.
        settled: share of the lengthening under the first tension that came before the arm was
            tensioned; 1 leaves a rest constant, 0 is a new cable.
    """

    compliance_m_n: Array
    time_s: Array
    settled: float

    @property
    def any(self) -> bool:
        """Whether there is any."""
        return bool(self.compliance_m_n.any())


def no_friction(body: Body) -> Friction:
    """Joints and cables that slide freely."""
    zero = np.zeros((body.joint_count, 2))
    return Friction(
        coefficient=np.zeros(body.cable_count),
        pulley_rad=0.0,
        onset=Onset.SHARP,
        reach_m=5e-6,
        spread=False,
        joint_nm=zero,
        joint_onset=Onset.SHARP,
        joint_reach_rad=2e-4,
        breakaway=1.0,
        speed_rad_s=0.02,
    )


def no_creep(body: Body) -> Creep:
    """Cables without creep."""
    return Creep(np.zeros((1, body.cable_count)), np.ones(1), 1.0)


def piece_compliance_m_n(body: Body, run_m: float, spread: bool) -> Array:
    """(2J + 2, M) compliance of the pieces: at the sensor, the run, then by joint across, inside.

    They add up to the cable's 1 / stiffness. Not spread, all of it is the run's.
    """
    joints = body.joint_count
    length = np.zeros((2 * joints + 2, body.cable_count))
    length[1] = run_m
    if spread:
        across = np.linalg.norm(body.after_m - body.before_m, axis=-1)
        length[2::2] = across * body.passes
        inside = body.before_m[1:] - body.after_m[:-1]
        inside[..., 0] += body.spacing_m[1:, None]
        length[3:-1:2] = np.linalg.norm(inside, axis=-1) * body.passes[1:]
    share = length / length.sum(axis=0)
    if spread:
        share *= 1.0 - _ACTUATOR_SHARE
        share[0] = _ACTUATOR_SHARE
    return share / body.stiffness_n_m
