"""What acts on the arm from outside, and from inside its joints."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cablesense_gap.plant.body import TipSpring
from cablesense_gap.plant.change import Change, some
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.real_arm import RealArm


def cogging(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Joints with notches: a torque periodic in their angle."""
    share = np.zeros((nominal.segment_count, 2))
    share[some(rng, nominal.segment_count, 1, 2)] = 1.0
    per_turn = float(rng.uniform(40.0, 90.0))
    return Change(
        "unknown", "cogging", "N m", 0.005, 3.0, partial(_cogging, share=share, per_turn=per_turn)
    )


def _cogging(arm: RealArm, size: float, share: np.ndarray, per_turn: float) -> RealArm:
    body = replace(arm.body, cogging_nm=size * share, cogging_per_turn=per_turn)
    return replace(arm, body=body)


def tether(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A hose or a band from the arm's end to somewhere beside it."""
    reach = nominal.plate_offset_m + nominal.segment_count * nominal.length_m
    angle, away_m = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.1, 0.4)
    anchor = (
        float(reach + rng.uniform(-0.2, 0.1)),
        float(away_m * np.sin(angle)),
        float(away_m * np.cos(angle)),
    )
    spring = TipSpring(anchor, 1.0)
    return Change("unknown", "tether", "N/m", 0.3, 300.0, partial(_touched, spring=spring))


def wall(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Something springy that the arm's end runs against on one side."""
    reach = nominal.plate_offset_m + nominal.segment_count * nominal.length_m
    angle, away_m = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.003, 0.03)
    normal = (0.0, float(np.sin(angle)), float(np.cos(angle)))
    anchor = (reach, away_m * normal[1], away_m * normal[2])
    spring = TipSpring(anchor, 1.0, normal)
    return Change("unknown", "wall", "N/m", 5.0, 2e4, partial(_touched, spring=spring))


def _touched(arm: RealArm, size: float, spring: TipSpring) -> RealArm:
    springs = (replace(spring, stiffness_n_m=size),)
    return replace(arm, body=replace(arm.body, tip_springs=springs))
