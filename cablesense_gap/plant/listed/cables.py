"""Friction, creep, stiffness and pretension of cables."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cablesense_gap.plant.change import Change, places, some, weights
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.real_arm import RealArm
from cablesense_gap.plant.rubbing import Creep
from cablesense_gap.plant.slip import Onset

_CREEP_FORMS = {
    "one time": np.array([1.0]),
    "three times": np.array([0.1, 1.0, 8.0]),
    "logarithmic": np.logspace(-1.5, 1.5, 8),
}


def capstan_friction(rng: np.random.Generator, nominal: Nominal) -> Change:
    """T2 <= T1 exp(mu theta) at every guide: sharp or rounded, with or without a pulley."""
    onset = Onset.SHARP if rng.random() < 0.5 else Onset.ROUNDED
    spread, pulley = bool(rng.random() < 0.5), bool(rng.random() < 0.4)
    reach_m = 5e-6 if onset is Onset.SHARP else float(np.exp(rng.uniform(*np.log([2e-5, 2e-4]))))
    wrap = float(rng.uniform(0.3, 1.6)) if pulley else 0.0
    stretch = "stretch all along" if spread else "stretch in the run"
    return Change(
        effect="capstan_friction",
        form=f"{onset} onset, {stretch}, {'with' if pulley else 'no'} pulley",
        unit="1",
        least=0.003,
        most=0.4,
        apply=partial(
            _rubbing_cables, onset=onset, reach_m=reach_m, spread=spread, pulley_rad=wrap
        ),
        details={"reach_m": reach_m, "pulley_rad": wrap},
    )


def _rubbing_cables(
    arm: RealArm, size: float, onset: Onset, reach_m: float, spread: bool, pulley_rad: float
) -> RealArm:
    rubbing = replace(
        arm.rubbing,
        coefficient=np.full(arm.nominal.cable_count, size),
        pulley_rad=pulley_rad,
        onset=onset,
        reach_m=reach_m,
        spread=spread,
    )
    return replace(arm, rubbing=rubbing)


def creep(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Kelvin-Voigt elements in series: one, three or many times, new cables or settled ones."""
    form = str(rng.choice(list(_CREEP_FORMS)))
    time_s = float(np.exp(rng.uniform(*np.log([8.0, 80.0]))))
    settled = float(rng.choice([0.0, 1.0, rng.uniform()]))
    chosen, where = _all_or_segment(rng, nominal)
    return Change(
        effect="cable_creep",
        form=f"{form}, {'new' if settled == 0.0 else 'settled' if settled == 1.0 else 'used'}",
        unit="of the elastic stretch",
        least=0.01,
        most=1.5,
        apply=partial(
            _creeping,
            cables=chosen,
            time_s=np.clip(time_s * _CREEP_FORMS[form], 1.0, 2000.0),
            settled=settled,
        ),
        where=where,
        details={"time_s": time_s, "settled": settled},
    )


def _creeping(
    arm: RealArm, size: float, cables: np.ndarray, time_s: np.ndarray, settled: float
) -> RealArm:
    total = size * cables / arm.body.stiffness_n_m
    compliance = np.tile(total / len(time_s), (len(time_s), 1))
    return replace(arm, creep=Creep(compliance, time_s, settled))


def stiffness(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Softer or harder cables, all or those that end on a segment."""
    chosen, where = _all_or_segment(rng, nominal)
    softer = bool(rng.random() < 0.5)
    return Change(
        effect="cable_stiffness",
        form="softer" if softer else "harder",
        unit="of the nominal",
        least=0.01,
        most=0.5 if softer else 1.5,
        apply=partial(_stiffness, cables=chosen, sign=-1.0 if softer else 1.0),
        where=where,
    )


def _stiffness(arm: RealArm, size: float, cables: np.ndarray, sign: float) -> RealArm:
    factor = 1.0 + sign * min(size, 3.0 if sign > 0.0 else 0.8) * cables
    body = replace(arm.body, stiffness_n_m=arm.body.stiffness_n_m * factor)
    return replace(arm, body=body)


def pretension_error(rng: np.random.Generator, nominal: Nominal) -> Change:
    """One to all cables tensioned to another value, all by the same or each by its own."""
    count = nominal.cable_count
    chosen = some(rng, count, 1, 4) if rng.random() < 0.7 else some(rng, count, 1, count)
    alike = bool(rng.random() < 0.7)
    own = weights(rng, chosen, count, signed=True)
    share = np.where(own != 0.0, rng.choice([-1.0, 1.0]), 0.0) if alike else own
    return Change(
        effect="pretension_error",
        form="all by the same" if alike else "each by its own",
        unit="N",
        least=0.3,
        most=30.0,
        apply=partial(_pretension, share=share),
        where=places("cable", chosen, count),
    )


def _pretension(arm: RealArm, size: float, share: np.ndarray) -> RealArm:
    tension = np.maximum(arm.body.pretension_n + size * share, 5.0)
    return replace(arm, body=replace(arm.body, pretension_n=tension))


def _all_or_segment(
    rng: np.random.Generator, nominal: Nominal
) -> tuple[np.ndarray, tuple[str, ...]]:
    """(M,) of 0 and 1, and their place."""
    if rng.random() < 0.5:
        return np.ones(nominal.cable_count), ()
    segment = int(rng.integers(nominal.segment_count))
    ends_on = np.arange(nominal.cable_count) // nominal.per_segment
    return (ends_on == segment).astype(float), (f"segment_{segment + 1}",)
