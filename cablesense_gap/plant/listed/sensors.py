"""Tension sensors that do not say what is."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cablesense_gap.plant.change import Change, places, some, weights
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.real_arm import RealArm
from cablesense_gap.plant.sensing import Filter
from cablesense_gap.plant.wander import Course, Wander


def gain(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Wrong scale on one to four sensors."""
    count = nominal.cable_count
    chosen = some(rng, count, 1, 4)
    return Change(
        effect="sensor_gain",
        form="each by its own",
        unit="1",
        least=0.001,
        most=0.4,
        apply=partial(_gain, share=weights(rng, chosen, count, signed=True)),
        where=places("cable", chosen, count),
    )


def _gain(arm: RealArm, size: float, share: np.ndarray) -> RealArm:
    return _sensing(arm, gain=arm.sensing.gain * (1.0 + size * share))


def offset(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Zero errors on one to four sensors."""
    count = nominal.cable_count
    chosen = some(rng, count, 1, 4)
    return Change(
        effect="sensor_offset",
        form="each by its own",
        unit="N",
        least=0.1,
        most=30.0,
        apply=partial(_offset, share=weights(rng, chosen, count, signed=True)),
        where=places("cable", chosen, count),
    )


def _offset(arm: RealArm, size: float, share: np.ndarray) -> RealArm:
    return _sensing(arm, offset_n=arm.sensing.offset_n + size * share)


def drift(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Zeros that wander: steadily, slowly to and fro, at random, or while warming up."""
    count = nominal.cable_count
    chosen = some(rng, count, 1, 4)
    course = Course(str(rng.choice([str(course) for course in Course])))
    period = (60.0, 400.0) if course is Course.SINE else (20.0, 90.0)
    time_s = float(rng.uniform(*period))
    wander = Wander(
        weights(rng, chosen, count, signed=True),
        course,
        time_s,
        float(rng.uniform(0.0, 2.0 * np.pi)),
        int(rng.integers(2**31)),
    )
    return Change(
        effect="sensor_drift",
        form=str(course),
        unit="N",
        least=0.1,
        most=40.0,
        apply=partial(_drift, wander=wander),
        where=places("cable", chosen, count),
        details={"time_s": time_s},
    )


def _drift(arm: RealArm, size: float, wander: Wander) -> RealArm:
    return _sensing(arm, wander=replace(wander, size_n=size * wander.size_n))


def crosstalk(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A share of one channel in its neighbours, or of every channel in its neighbours.

    The place is the channel whose signal leaks.
    """
    count = nominal.cable_count
    one = bool(rng.random() < 0.6)
    source = int(rng.integers(count))
    leak = np.zeros((count, count))
    for channel in [source] if one else range(count):
        for neighbour in {channel - 1, channel + 1} & set(range(count)):
            leak[neighbour, channel] = 1.0
    return Change(
        effect="sensor_crosstalk",
        form="one channel into its neighbours" if one else "all channels into their neighbours",
        unit="1",
        least=0.0005,
        most=0.3,
        apply=partial(_leak, leak=leak * float(rng.choice([-1.0, 1.0], p=[0.2, 0.8]))),
        where=(f"cable_{source + 1}",) if one else (),
    )


def _leak(arm: RealArm, size: float, leak: np.ndarray) -> RealArm:
    return _sensing(arm, leak=size * leak)


def lag(rng: np.random.Generator, nominal: Nominal) -> Change:
    """All or some sensors that follow late, through one of three filters."""
    count = nominal.cable_count
    chosen = list(range(count)) if rng.random() < 0.4 else some(rng, count, 1, 4)
    kind = Filter(str(rng.choice([str(kind) for kind in Filter])))
    return Change(
        effect="sensor_lag",
        form=str(kind),
        unit="s",
        least=0.01,
        most=8.0,
        apply=partial(_lag, sensors=chosen, kind=kind),
        where=places("cable", chosen, count),
    )


def _lag(arm: RealArm, size: float, sensors: list[int], kind: Filter) -> RealArm:
    lag_s = np.zeros(arm.nominal.cable_count)
    lag_s[sensors] = size
    return _sensing(arm, lag_s=lag_s, lag_filter=kind)


def _sensing(arm: RealArm, **changed: object) -> RealArm:
    return replace(arm, sensing=replace(arm.sensing, **changed))  # type: ignore[arg-type]
