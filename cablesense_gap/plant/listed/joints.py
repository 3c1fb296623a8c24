"""Friction and springs of joints."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cablesense_gap.plant.change import Change, places, some
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.real_arm import RealArm
from cablesense_gap.plant.slip import Onset


def friction(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Dry friction in both axes of one, two or all joints: sharp, rounded or Stribeck's."""
    chosen = _some_joints(rng, nominal)
    form = str(rng.choice(["sharp", "rounded", "Stribeck"]))
    rounded = form == "rounded"
    return Change(
        effect="joint_friction",
        form=form,
        unit="N m",
        least=0.005,
        most=2.0,
        apply=partial(
            _rubbing_joints,
            joints=chosen,
            onset=Onset.ROUNDED if rounded else Onset.SHARP,
            reach_rad=float(rng.uniform(5e-4, 3e-3)) if rounded else 1e-4,
            breakaway=float(rng.uniform(1.2, 1.8)) if form == "Stribeck" else 1.0,
        ),
        where=places("joint", chosen, nominal.segment_count),
    )


def _rubbing_joints(
    arm: RealArm,
    size: float,
    joints: list[int],
    onset: Onset,
    reach_rad: float,
    breakaway: float,
) -> RealArm:
    torque = np.zeros((arm.body.joint_count, 2))
    torque[arm.body.driven[joints]] = size
    rubbing = replace(
        arm.rubbing,
        joint_nm=torque,
        joint_onset=onset,
        joint_reach_rad=reach_rad,
        breakaway=breakaway,
    )
    return replace(arm, rubbing=rubbing)


def elasticity(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Joints that spring back to straight, linearly or hardening a little."""
    one = rng.random() < 0.6
    count = nominal.segment_count
    chosen = [int(rng.integers(count))] if one else list(range(count))
    hardening = float(rng.choice([0.0, rng.uniform(3.0, 15.0)]))
    return Change(
        effect="joint_elasticity",
        form="hardening" if hardening else "linear",
        unit="N m/rad",
        least=0.05,
        most=80.0,
        apply=partial(_sprung, joints=chosen, hardening_rad2=hardening),
        where=places("joint", chosen, count),
        details={"hardening_rad2": hardening},
    )


def _sprung(arm: RealArm, size: float, joints: list[int], hardening_rad2: float) -> RealArm:
    spring = np.zeros((arm.body.joint_count, 2))
    spring[arm.body.driven[joints]] = size
    body = replace(arm.body, spring_nm_rad=spring, hardening_nm_rad3=hardening_rad2 * spring)
    return replace(arm, body=body)


def _some_joints(rng: np.random.Generator, nominal: Nominal) -> list[int]:
    count = nominal.segment_count
    return list(range(count)) if rng.random() < 0.3 else some(rng, count, 1, 2)
