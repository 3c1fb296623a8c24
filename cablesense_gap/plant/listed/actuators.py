"""Lost motion in actuators."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cablesense_gap.plant.change import Change, places, some, weights
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.real_arm import RealArm


def backlash(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Play in one to four actuators, equal or uneven; where in it each begins is unknown."""
    chosen = some(rng, nominal.cable_count, 1, 4)
    uneven = len(chosen) > 1 and rng.random() < 0.5
    share = weights(rng, chosen, nominal.cable_count)
    return Change(
        effect="actuator_backlash",
        form="uneven play" if uneven else "equal play",
        unit="m",
        least=1e-6,
        most=1e-3,
        apply=partial(
            _with_play,
            share=share if uneven else (share > 0.0).astype(float),
            start=rng.uniform(-1.0, 1.0, nominal.cable_count),
        ),
        where=places("cable", chosen, nominal.cable_count),
    )


def _with_play(arm: RealArm, size: float, share: np.ndarray, start: np.ndarray) -> RealArm:
    return replace(arm, actuation=replace(arm.actuation, play_m=size * share, play_start=start))
