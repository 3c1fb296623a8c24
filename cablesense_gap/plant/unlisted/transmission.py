"""Between actuator and segment: wrong ratios, uneven screws, slipping clamps, odd cables."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cablesense_gap.plant.body import Snag
from cablesense_gap.plant.change import Change, some, weights
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.real_arm import RealArm


def actuator_ratio(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Actuators that pay out more or less than they are told."""
    count = nominal.cable_count
    share = weights(rng, some(rng, count, 1, 3), count, signed=True)
    return Change("unknown", "actuator_ratio", "1", 5e-4, 0.3, partial(_ratio, share=share))


def _ratio(arm: RealArm, size: float, share: np.ndarray) -> RealArm:
    return replace(arm, actuation=replace(arm.actuation, ratio=1.0 + size * share))


def screw_error(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Screws with an error that repeats every turn."""
    count = nominal.cable_count
    return Change(
        "unknown",
        "screw_error",
        "m",
        2e-6,
        1e-3,
        partial(
            _screw,
            share=weights(rng, some(rng, count, 2, 6), count),
            pitch_m=float(rng.uniform(0.002, 0.006)),
            phase_rad=rng.uniform(0.0, 2.0 * np.pi, count),
        ),
    )


def _screw(
    arm: RealArm, size: float, share: np.ndarray, pitch_m: float, phase_rad: np.ndarray
) -> RealArm:
    actuation = replace(
        arm.actuation, screw_m=size * share, screw_pitch_m=pitch_m, screw_phase_rad=phase_rad
    )
    return replace(arm, actuation=actuation)


def clamp_slip(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A clamp or two that let cable through at one moment of the recording."""
    count = nominal.cable_count
    return Change(
        "unknown",
        "clamp_slip",
        "m",
        5e-6,
        2e-3,
        partial(
            _slip,
            share=weights(rng, some(rng, count, 1, 2), count),
            time_s=float(rng.uniform(60.0, 220.0)),
        ),
    )


def _slip(arm: RealArm, size: float, share: np.ndarray, time_s: float) -> RealArm:
    return replace(arm, actuation=replace(arm.actuation, slip_m=size * share, slip_time_s=time_s))


def hardening_cables(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Cables stiffer the more they carry, as drawn at the pretension."""
    del rng, nominal
    return Change("unknown", "hardening_cables", "of the exponent", 0.01, 3.0, _hardening)


def _hardening(arm: RealArm, size: float) -> RealArm:
    return replace(arm, body=replace(arm.body, exponent=1.0 + size))


def snagging_cables(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Cables that touch and push each other aside where a joint bends one way."""
    joint = int(rng.integers(nominal.segment_count))
    passing = np.arange(joint * nominal.per_segment, nominal.cable_count)
    pair = tuple(int(c) for c in rng.choice(passing, 2, replace=False))
    axis = int(rng.integers(2))
    sign = float(rng.choice([-1.0, 1.0]))
    toward = (sign, 0.0) if axis == 0 else (0.0, sign)
    snag = Snag(joint, toward, pair, 1.0, float(rng.uniform(0.0, 0.06)))
    return Change("unknown", "snagging_cables", "m/rad^2", 1e-3, 1.0, partial(_snag, snag=snag))


def _snag(arm: RealArm, size: float, snag: Snag) -> RealArm:
    return replace(arm, body=replace(arm.body, snags=(replace(snag, depth_m_rad2=size),)))
