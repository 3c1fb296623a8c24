"""What in an arm rubs and creeps: the parameters of everything that remembers.

Dry friction as a state between -1 and 1 that follows a sliding distance and holds at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.plant.body import Body


class Onset(StrEnum):
    """How friction builds up before it slides."""

    SHARP = "sharp"
    ROUNDED = "rounded"


def follow(onset: Onset, state: Array, moved: Array, reach: float) -> tuple[Array, Array]:
    """New state and its derivative by the distance moved since the state was left.

    Sharp friction is a spring of `reach` that then slides (Prandtl 1928); rounded friction nears
    its full value as exp(-moved / reach) (Dahl 1968). Neither knows time: what does not move keeps
    its state.
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
class Rubbing:
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
        """Whether anything rubs."""
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
        """Whether anything creeps."""
        return bool(self.compliance_m_n.any())


def smooth(body: Body) -> Rubbing:
    """Nothing rubs."""
    zero = np.zeros((body.joint_count, 2))
    return Rubbing(
        np.zeros(body.cable_count),
        0.0,
        Onset.SHARP,
        5e-6,
        False,
        zero,
        Onset.SHARP,
        2e-4,
        1.0,
        0.02,
    )


def firm(body: Body) -> Creep:
    """Nothing creeps."""
    return Creep(np.zeros((1, body.cable_count)), np.ones(1), 1.0)


ACTUATOR_SHARE = 0.3
"""Part of a cable's compliance that is its actuator's, where the rest is spread."""


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
        share *= 1.0 - ACTUATOR_SHARE
        share[0] = ACTUATOR_SHARE
    return share / body.stiffness_n_m
