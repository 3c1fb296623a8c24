"""What is wrong with the measurement itself: of the loads, and of the tensions."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cablesense_gap.plant.change import Change, some, weights
from cablesense_gap.plant.freezing import Freezing
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.real_arm import RealArm


def load_direction(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A load frame that is turned against the base: loads do not point where they are said to."""
    del nominal
    vector = np.array([1.0, 0.0, 0.0]) * rng.choice([-1.0, 1.0]) + rng.uniform(-0.4, 0.4, 3)
    return Change(
        "unknown", "load_direction", "deg", 0.3, 40.0, partial(_load_turned, vector=vector)
    )


def _load_turned(arm: RealArm, size: float, vector: np.ndarray) -> RealArm:
    from scipy.spatial.transform import Rotation

    axis = vector / np.linalg.norm(vector)
    turn = Rotation.from_rotvec(np.deg2rad(size) * axis).as_matrix()
    return replace(arm, load_turn=turn @ arm.load_turn)


def load_scale(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A load cell of the wrong scale: loads are weaker or stronger than written down."""
    del nominal
    sign = float(rng.choice([-1.0, 1.0]))
    return Change("unknown", "load_scale", "1", 0.003, 0.5, partial(_load_scaled, sign=sign))


def _load_scaled(arm: RealArm, size: float, sign: float) -> RealArm:
    return replace(arm, load_turn=(1.0 + sign * size) * arm.load_turn)


def sensor_bow(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Sensors whose scale changes with the tension."""
    count = nominal.cable_count
    chosen = list(range(count)) if rng.random() < 0.5 else some(rng, count, 2, 6)
    bow = np.zeros(count)
    bow[chosen] = rng.choice([-1.0, 1.0])
    return Change("unknown", "sensor_bow", "1/N", 2e-5, 0.01, partial(_bow, share=bow))


def _bow(arm: RealArm, size: float, share: np.ndarray) -> RealArm:
    return replace(arm, sensing=replace(arm.sensing, bow_per_n=size * share))


def sensor_ceiling(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Sensors or amplifiers that do not follow high tensions; the size is how far below 250 N."""
    count = nominal.cable_count
    chosen = list(range(count)) if rng.random() < 0.5 else some(rng, count, 2, 6)
    return Change("unknown", "sensor_ceiling", "N", 30.0, 195.0, partial(_ceiling, sensors=chosen))


def _ceiling(arm: RealArm, size: float, sensors: list[int]) -> RealArm:
    ceiling = np.full(arm.nominal.cable_count, np.inf)
    ceiling[sensors] = 250.0 - size
    return replace(arm, sensing=replace(arm.sensing, ceiling_n=ceiling))


def sensor_dropouts(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Channels that now and then repeat their last value for a while."""
    count = nominal.cable_count
    freezing = Freezing(
        weights(rng, some(rng, count, 1, 6), count),
        float(rng.uniform(8.0, 40.0)),
        int(rng.integers(2**31)),
    )
    return Change(
        "unknown", "sensor_dropouts", "of the rows", 0.01, 0.6, partial(_frozen, freezing=freezing)
    )


def _frozen(arm: RealArm, size: float, freezing: Freezing) -> RealArm:
    shares = replace(freezing, share=size * freezing.share)
    return replace(arm, sensing=replace(arm.sensing, freezing=shares))


def sensor_hum(rng: np.random.Generator, nominal: Nominal) -> Change:
    """An interference of a few tenths of a hertz on several channels."""
    count = nominal.cable_count
    return Change(
        "unknown",
        "sensor_hum",
        "N",
        0.1,
        15.0,
        partial(
            _hum,
            share=weights(rng, some(rng, count, 3, 8), count),
            hz=float(rng.uniform(0.15, 0.9)),
            phase_rad=np.full(count, rng.uniform(0.0, 2.0 * np.pi)),
        ),
    )


def _hum(
    arm: RealArm, size: float, share: np.ndarray, hz: float, phase_rad: np.ndarray
) -> RealArm:
    sensing = replace(arm.sensing, hum_n=size * share, hum_hz=hz, hum_phase_rad=phase_rad)
    return replace(arm, sensing=sensing)
