"""Weights and loads that are not as believed."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cablesense_gap.plant.change import Change
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.real_arm import RealArm


def payload(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A mass on a segment's axis, anywhere along it."""
    segment = int(rng.integers(nominal.segment_count))
    at_m = float(rng.uniform(0.0, nominal.length_m))
    return Change(
        effect="payload",
        form="point mass",
        unit="kg",
        least=0.005,
        most=4.0,
        apply=partial(_loaded, segment=segment, at_m=at_m),
        where=(f"segment_{segment + 1}",),
        details={"at_m": at_m},
    )


def _loaded(arm: RealArm, size: float, segment: int, at_m: float) -> RealArm:
    body = arm.body
    return replace(
        arm,
        body=replace(
            body,
            mass_kg=np.append(body.mass_kg, size),
            mass_joint=np.append(body.mass_joint, body.driven[segment]),
            mass_at_m=np.vstack([body.mass_at_m, [at_m, 0.0, 0.0]]),
        ),
    )


def base_tilt(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A base that is not level: rolled, pitched or both; loads stay in base axes."""
    form = str(rng.choice(["roll", "pitch", "roll and pitch"]))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    axis = {"roll": (1.0, 0.0), "pitch": (0.0, 1.0)}.get(form, (np.cos(angle), np.sin(angle)))
    sign = float(rng.choice([-1.0, 1.0]))
    return Change(
        effect="base_tilt",
        form=form,
        unit="deg",
        least=0.1,
        most=30.0,
        apply=partial(_tilted, axis=(sign * float(axis[0]), sign * float(axis[1]))),
        details={"about_x": sign * float(axis[0]), "about_y": sign * float(axis[1])},
    )


def _tilted(arm: RealArm, size: float, axis: tuple[float, float]) -> RealArm:
    from scipy.spatial.transform import Rotation

    base = Rotation.from_rotvec(np.deg2rad(size) * np.array([*axis, 0.0]))
    gravity = base.inv().apply(arm.body.gravity_m_s2)
    return replace(arm, body=replace(arm.body, gravity_m_s2=gravity))


def contact_offset(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Loads that act nearer to the base or to the tip, on one segment or on all."""
    count = nominal.segment_count
    one = bool(rng.random() < 0.6)
    segment = int(rng.integers(count))
    shift = np.zeros(count)
    shift[segment if one else slice(None)] = rng.choice([-1.0, 1.0])
    return Change(
        effect="contact_offset",
        form="one segment" if one else "all segments",
        unit="m",
        least=0.0005,
        most=0.05,
        apply=partial(_shifted, shift=shift),
        where=(f"segment_{segment + 1}",) if one else (),
        details={"toward_tip": float(shift[segment])},
    )


def _shifted(arm: RealArm, size: float, shift: np.ndarray) -> RealArm:
    contact = arm.body.contact_at_m.copy()
    contact[:, 0] += size * shift
    return replace(arm, body=replace(arm.body, contact_at_m=contact))
