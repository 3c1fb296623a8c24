"""The arm's structure: segments that bend, that are longer than drawn, axes that are skewed."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cablesense_gap.plant.body import Body
from cablesense_gap.plant.change import Change, some
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.real_arm import RealArm
from cablesense_gap.plant.rubbing import firm, smooth


def limber_segments(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Segments that bend in their middle under what they carry."""
    del rng, nominal
    return Change("unknown", "limber_segments", "rad/(N m)", 1e-4, 0.05, _limber)


def _limber(arm: RealArm, size: float) -> RealArm:
    body = _with_middles(arm.body, 1.0 / size)
    return replace(arm, body=body, rubbing=smooth(body), creep=firm(body))


def _with_middles(body: Body, stiffness_nm_rad: float) -> Body:
    """Each joint followed by a sprung one halfway to the next; what hung on it hangs behind."""
    count = body.joint_count
    ends = np.append(body.spacing_m[1:], body.tip_at_m[0])
    half = 0.5 * ends
    spacing = np.empty(2 * count)
    spacing[0::2] = np.append(body.spacing_m[0], half[:-1])
    spacing[1::2] = half
    before = np.repeat(body.before_m, 2, axis=0)
    after = np.repeat(body.after_m, 2, axis=0)
    before[1::2], after[1::2] = body.after_m, body.after_m
    before[1::2, :, 0] -= half[:, None]
    after[1:-1:2] = body.before_m[1:]
    after[1:-1:2, :, 0] += half[:-1, None]
    passes = np.zeros((2 * count, body.cable_count), dtype=bool)
    passes[0::2] = body.passes
    passes[1:-1:2] = body.passes[1:]
    spring = np.zeros((2 * count, 2))
    spring[1::2] = stiffness_nm_rad
    back = np.zeros((count, 3))
    back[:, 0] = half

    def doubled(values: np.ndarray) -> np.ndarray:
        wide = np.zeros((2 * count, *values.shape[1:]))
        wide[0::2] = values
        return wide

    return replace(
        body,
        spacing_m=spacing,
        before_m=before,
        after_m=after,
        passes=passes,
        skew=np.repeat(body.skew, 2, axis=0),
        mass_joint=2 * body.mass_joint + 1,
        mass_at_m=body.mass_at_m - back[body.mass_joint],
        contact_joint=2 * body.contact_joint + 1,
        contact_at_m=body.contact_at_m - back[body.contact_joint],
        tip_at_m=body.tip_at_m - back[-1],
        spring_nm_rad=doubled(body.spring_nm_rad) + spring,
        hardening_nm_rad3=doubled(body.hardening_nm_rad3),
        cogging_nm=doubled(body.cogging_nm),
        driven=2 * body.driven,
    )


def link_length(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A segment that is longer or shorter than drawn, so that the next joint is elsewhere."""
    joint = int(rng.integers(1, nominal.segment_count))
    sign = float(rng.choice([-1.0, 1.0]))
    return Change(
        "unknown", "link_length", "m", 5e-4, 0.045, partial(_longer, joint=joint, sign=sign)
    )


def _longer(arm: RealArm, size: float, joint: int, sign: float) -> RealArm:
    spacing = arm.body.spacing_m.copy()
    spacing[joint] += sign * size
    return replace(arm, body=replace(arm.body, spacing_m=spacing))


def skewed_axes(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Joints whose axes are turned against the plates."""
    vector = np.zeros((nominal.segment_count, 3))
    chosen = some(rng, nominal.segment_count, 1, 2)
    directions = rng.standard_normal((len(chosen), 3))
    vector[chosen] = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return Change("unknown", "skewed_axes", "deg", 1.0, 30.0, partial(_skewed, vector=vector))


def _skewed(arm: RealArm, size: float, vector: np.ndarray) -> RealArm:
    from scipy.spatial.transform import Rotation

    skew = Rotation.from_rotvec(np.deg2rad(size) * vector).as_matrix()
    return replace(arm, body=replace(arm.body, skew=skew))
