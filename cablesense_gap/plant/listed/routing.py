"""Guide holes that are elsewhere than drawn."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cablesense_gap.plant.change import Change
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.real_arm import RealArm
from cablesense_gap.plant.scatter import turned


def routing_geometry(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A segment's holes on another radius or at another angle, by either reading of "a segment's".

    Those of the cables that end on it, in every plate they pass; or those of all cables in the
    two plates that the segment carries.
    """
    segment = int(rng.integers(nominal.segment_count))
    radius = bool(rng.random() < 0.5)
    carried = bool(rng.random() < 0.4)
    of = "plates of the segment" if carried else "cables that end on the segment"
    return Change(
        effect="routing_geometry",
        form=f"{'radius' if radius else 'angle'}, {of}",
        unit="m" if radius else "deg",
        least=5e-5 if radius else 0.1,
        most=0.012 if radius else 15.0,
        apply=partial(
            _rerouted,
            segment=segment,
            radius=radius,
            carried=carried,
            sign=float(rng.choice([-1.0, 1.0])),
        ),
        where=(f"segment_{segment + 1}",),
    )


def _rerouted(
    arm: RealArm, size: float, segment: int, radius: bool, carried: bool, sign: float
) -> RealArm:
    body = arm.body
    before, after = np.zeros(body.before_m.shape[:2]), np.zeros(body.after_m.shape[:2])
    if carried:
        after[segment] = sign
        before[segment + 1 : segment + 2] = sign
    else:
        own = np.arange(body.cable_count) // arm.nominal.per_segment == segment
        before[:, own] = after[:, own] = sign
    move = _further_out if radius else _turned_deg
    moved = replace(
        body,
        before_m=move(body.before_m, size * before),
        after_m=move(body.after_m, size * after),
    )
    return replace(arm, body=moved)


def _turned_deg(points_m: np.ndarray, by_deg: np.ndarray) -> np.ndarray:
    return turned(points_m, np.deg2rad(by_deg))


def _further_out(points_m: np.ndarray, by_m: np.ndarray) -> np.ndarray:
    moved = points_m.copy()
    radius = np.linalg.norm(moved[..., 1:], axis=-1)
    moved[..., 1:] *= ((radius + by_m) / radius)[..., None]
    return moved
