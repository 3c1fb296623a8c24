"""The effects that verdicts have names for, drawn in the forms that physics offers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_gap.plant.arm import RealArm, turned
from cablesense_gap.plant.body import Creep, Nominal
from cablesense_gap.plant.change import (
    Change,
    Draws,
    added,
    grown,
    marked,
    places,
    scaled,
    sets,
    sized,
    some,
    weights,
)
from cablesense_gap.plant.sensing import Drift, DriftShape, Filter

Rng = np.random.Generator

_CREEP_TIMES = {
    "one time": np.array([1.0]),
    "three times": np.array([0.1, 1.0, 8.0]),
    "logarithmic": np.logspace(-1.5, 1.5, 8),
}
_DRAWS = Draws()


@_DRAWS.of_size("m", 1e-6, 1e-3)
def actuator_backlash(rng: Rng, nominal: Nominal) -> Change:
    """Play in one to four actuators, equal or uneven; where in it each begins is unknown."""
    count = nominal.cable_count
    chosen = some(rng, count, 1, 4)
    uneven = len(chosen) > 1 and rng.random() < 0.5
    uneven_share = weights(rng, chosen, count)
    share = uneven_share if uneven else marked(chosen, count)
    return Change(
        sets("actuation", play_m=(scaled, share), play_start=rng.uniform(-1.0, 1.0, count)),
        "uneven play" if uneven else "equal play",
        places("cable", chosen, count),
    )


@_DRAWS.of_size("deg", 0.1, 30.0)
def base_tilt(rng: Rng, nominal: Nominal) -> Change:
    """A base that is not level: rolled, pitched or both; loads stay in base axes."""
    form = str(rng.choice(["roll", "pitch", "roll and pitch"]))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    axis = {"roll": (1.0, 0.0), "pitch": (0.0, 1.0)}.get(form, (np.cos(angle), np.sin(angle)))
    sign = float(rng.choice([-1.0, 1.0]))
    x, y = sign * float(axis[0]), sign * float(axis[1])
    tilted = sets("body", gravity_m_s2=(_tilted, (x, y, 0.0)))
    return Change(tilted, form, details={"about_x": x, "about_y": y})


def _tilted(gravity: Array, size: float, axis: tuple[float, float, float]) -> Array:
    from scipy.spatial.transform import Rotation

    base = Rotation.from_rotvec(np.deg2rad(size) * np.array(axis))
    return np.asarray(base.inv().apply(gravity), dtype=float)


@_DRAWS.of_size("of the elastic stretch", 0.01, 1.5)
def cable_creep(rng: Rng, nominal: Nominal) -> Change:
    """Kelvin-Voigt elements in series: one, three or many times, new cables or settled ones."""
    form = str(rng.choice(list(_CREEP_TIMES)))
    time_s = float(np.exp(rng.uniform(*np.log([8.0, 80.0]))))
    settled = float(rng.choice([0.0, 1.0, rng.uniform()]))
    cables, where = _all_or_segment(rng, nominal)
    times = np.clip(time_s * _CREEP_TIMES[form], 1.0, 2000.0)
    return Change(
        partial(_creeping, cables=cables, time_s=times, settled=settled),
        f"{form}, {'new' if settled == 0.0 else 'settled' if settled == 1.0 else 'used'}",
        where,
        {"time_s": time_s, "settled": settled},
    )


def _creeping(arm: RealArm, size: float, cables: Array, time_s: Array, settled: float) -> RealArm:
    total = size * cables / arm.body.stiffness_n_m
    compliance = np.tile(total / len(time_s), (len(time_s), 1))
    return replace(arm, creep=Creep(compliance, time_s, settled))


@_DRAWS.of_size("of the nominal", 0.01, 1.5)
def cable_stiffness(rng: Rng, nominal: Nominal) -> Change:
    """Softer or harder cables, all or those that end on a segment."""
    cables, where = _all_or_segment(rng, nominal)
    if rng.random() < 0.5:
        return Change(sets("body", stiffness_n_m=(grown, -cables)), "softer", where, most=0.5)
    return Change(sets("body", stiffness_n_m=(grown, cables)), "harder", where)


@_DRAWS.of_size("1", 0.003, 0.4)
def capstan_friction(rng: Rng, nominal: Nominal) -> Change:
    """T2 <= T1 exp(mu theta) at every guide: sharp or rounded, with or without a pulley."""
    rounded = bool(rng.random() >= 0.5)
    spread, pulley = bool(rng.random() < 0.5), bool(rng.random() < 0.4)
    reach_m = float(np.exp(rng.uniform(*np.log([2e-5, 2e-4])))) if rounded else 5e-6
    wrap = float(rng.uniform(0.3, 1.6)) if pulley else 0.0
    stretch = "stretch all along" if spread else "stretch in the run"
    onset = "rounded" if rounded else "sharp"
    return Change(
        sets(
            "friction", coefficient=(scaled, np.ones(nominal.cable_count)),
            pulley_rad=wrap, rounded=rounded, reach_m=reach_m, spread=spread,
        ),
        f"{onset} onset, {stretch}, {'with' if pulley else 'no'} pulley",
        details={"reach_m": reach_m, "pulley_rad": wrap},
    )  # fmt: skip


@_DRAWS.of_size("m", 0.0005, 0.05)
def contact_offset(rng: Rng, nominal: Nominal) -> Change:
    """Loads that act nearer to the base or to the tip, on one segment or on all."""
    count = nominal.segment_count
    one = bool(rng.random() < 0.6)
    segment = int(rng.integers(count))
    shift = marked(segment if one else slice(None), count, rng.choice([-1.0, 1.0]))
    return Change(
        sets("body", contact_at_m=(added, np.outer(shift, [1.0, 0.0, 0.0]))),
        "one segment" if one else "all segments",
        (f"segment_{segment + 1}",) if one else (),
        {"toward_tip": float(shift[segment])},
    )


@_DRAWS.of_size("N m/rad", 0.05, 80.0)
def joint_elasticity(rng: Rng, nominal: Nominal) -> Change:
    """Joints that spring back to straight, linearly or hardening a little."""
    count = nominal.segment_count
    one = rng.random() < 0.6
    chosen = [int(rng.integers(count))] if one else list(range(count))
    hardening = float(rng.choice([0.0, rng.uniform(3.0, 15.0)]))
    share = _of_joints(chosen, count)
    return Change(
        sets("body", spring_nm_rad=(scaled, share), hardening_nm_rad3=(scaled, hardening * share)),
        "hardening" if hardening else "linear",
        places("joint", chosen, count),
        {"hardening_rad2": hardening},
    )


@_DRAWS.of_size("N m", 0.005, 2.0)
def joint_friction(rng: Rng, nominal: Nominal) -> Change:
    """Dry friction in both axes of one, two or all joints: sharp, rounded or Stribeck's."""
    count = nominal.segment_count
    chosen = list(range(count)) if rng.random() < 0.3 else some(rng, count, 1, 2)
    form = str(rng.choice(["sharp", "rounded", "Stribeck"]))
    rounded = form == "rounded"
    reach_rad = float(rng.uniform(5e-4, 3e-3)) if rounded else 1e-4
    breakaway = float(rng.uniform(1.2, 1.8)) if form == "Stribeck" else 1.0
    return Change(
        sets(
            "friction", joint_nm=(scaled, _of_joints(chosen, count)),
            joint_rounded=rounded, joint_reach_rad=reach_rad, breakaway=breakaway,
        ),
        form,
        places("joint", chosen, count),
    )  # fmt: skip


@_DRAWS.of_size("kg", 0.005, 4.0)
def payload(rng: Rng, nominal: Nominal) -> Change:
    """A mass on a segment's axis, anywhere along it."""
    segment = int(rng.integers(nominal.segment_count))
    at_m = float(rng.uniform(0.0, nominal.length_m))
    loaded = partial(_loaded, segment=segment, at_m=at_m)
    return Change(loaded, "point mass", (f"segment_{segment + 1}",), {"at_m": at_m})


def _loaded(arm: RealArm, size: float, segment: int, at_m: float) -> RealArm:
    body = arm.body
    joint = np.append(body.mass_joint, body.driven[segment])
    at = np.vstack([body.mass_at_m, [at_m, 0.0, 0.0]])
    mass = np.append(body.mass_kg, size)
    return replace(arm, body=replace(body, mass_kg=mass, mass_joint=joint, mass_at_m=at))


@_DRAWS.of_size("N", 0.3, 30.0)
def pretension_error(rng: Rng, nominal: Nominal) -> Change:
    """One to all cables tensioned to another value, all by the same or each by its own."""
    count = nominal.cable_count
    chosen = some(rng, count, 1, 4) if rng.random() < 0.7 else some(rng, count, 1, count)
    alike = bool(rng.random() < 0.7)
    own = weights(rng, chosen, count, signed=True)
    share = np.where(own != 0.0, rng.choice([-1.0, 1.0]), 0.0) if alike else own
    least = 0.1 * nominal.pretension_n
    return Change(
        sets("body", pretension_n=(_added_above, share, least)),
        "all by the same" if alike else "each by its own",
        places("cable", chosen, count),
    )


def _added_above(old: Array, size: float, share: Array, least: float) -> Array:
    return np.maximum(old + size * share, least)


@_DRAWS.of_size("deg", 0.1, 15.0)
def routing_geometry(rng: Rng, nominal: Nominal) -> Change:
    """A segment's holes on another radius or at another angle, by either reading of "a segment's".

    Those of the cables that end on it, in every plate they pass; or those of all cables in the
    two plates that the segment carries.
    """
    segment = int(rng.integers(nominal.segment_count))
    radius = bool(rng.random() < 0.5)
    carried = bool(rng.random() < 0.4)
    sign = float(rng.choice([-1.0, 1.0]))
    before, after = np.zeros((2, nominal.segment_count, nominal.cable_count))
    if carried:
        after[segment] = sign
        before[segment + 1 : segment + 2] = sign
    else:
        own = _ends_on(nominal, segment)
        before[:, own] = after[:, own] = sign
    of = "plates of the segment" if carried else "cables that end on the segment"
    where = (f"segment_{segment + 1}",)
    if radius:
        moved = sets("body", before_m=(_further_out, before), after_m=(_further_out, after))
        return Change(moved, f"radius, {of}", where, unit="m", least=5e-5, most=0.012)
    moved = sets("body", before_m=(_turned_deg, before), after_m=(_turned_deg, after))
    return Change(moved, f"angle, {of}", where)


def _turned_deg(points_m: Array, size: float, share: Array) -> Array:
    return turned(points_m, np.deg2rad(size * share))


def _further_out(points_m: Array, size: float, share: Array) -> Array:
    moved = points_m.copy()
    radius = np.linalg.norm(moved[..., 1:], axis=-1)
    moved[..., 1:] *= ((radius + size * share) / radius)[..., None]
    return moved


@_DRAWS.of_size("1", 0.0005, 0.3)
def sensor_crosstalk(rng: Rng, nominal: Nominal) -> Change:
    """A share of one channel in its neighbours, or of every channel in its neighbours.

    The place is the channel whose signal leaks.
    """
    count = nominal.cable_count
    one = bool(rng.random() < 0.6)
    source = int(rng.integers(count))
    leak = np.eye(count, k=1) + np.eye(count, k=-1)
    if one:
        leak *= marked(source, count)
    leak = leak * float(rng.choice([-1.0, 1.0], p=[0.2, 0.8]))
    return Change(
        sets("sensing", leak=(scaled, leak)),
        "one channel into its neighbours" if one else "all channels into their neighbours",
        (f"cable_{source + 1}",) if one else (),
    )


@_DRAWS.of_size("N", 0.1, 40.0)
def sensor_drift(rng: Rng, nominal: Nominal) -> Change:
    """Zeros that drift: steadily, slowly to and fro, at random, or while warming up."""
    count = nominal.cable_count
    chosen = some(rng, count, 1, 4)
    shape: Any = str(rng.choice(get_args(DriftShape)))
    time_s = float(rng.uniform(*((60.0, 400.0) if shape == "slow sine" else (20.0, 90.0))))
    share = weights(rng, chosen, count, signed=True)
    phase_rad = float(rng.uniform(0.0, 2.0 * np.pi))
    drift = Drift(share, shape, time_s, phase_rad, int(rng.integers(2**31)))
    drifting = sets("sensing", drift=(sized, drift, "size_n"))
    return Change(drifting, shape, places("cable", chosen, count), {"time_s": time_s})


@_DRAWS.of_size("1", 0.001, 0.4)
def sensor_gain(rng: Rng, nominal: Nominal) -> Change:
    """Wrong scale on one to four sensors."""
    share, where = _some_sensors(rng, nominal)
    return Change(sets("sensing", gain=(grown, share)), "each by its own", where)


@_DRAWS.of_size("s", 0.01, 8.0)
def sensor_lag(rng: Rng, nominal: Nominal) -> Change:
    """All or some sensors that follow late, through one of three filters."""
    count = nominal.cable_count
    chosen = list(range(count)) if rng.random() < 0.4 else some(rng, count, 1, 4)
    kind = str(rng.choice(get_args(Filter)))
    late = sets("sensing", lag_s=(scaled, marked(chosen, count)), lag_filter=kind)
    return Change(late, kind, places("cable", chosen, count))


@_DRAWS.of_size("N", 0.1, 30.0)
def sensor_offset(rng: Rng, nominal: Nominal) -> Change:
    """Zero errors on one to four sensors."""
    share, where = _some_sensors(rng, nominal)
    return Change(sets("sensing", offset_n=(added, share)), "each by its own", where)


def _some_sensors(rng: Rng, nominal: Nominal) -> tuple[Array, tuple[str, ...]]:
    """(M,) signed weights of one to four sensors, and their places."""
    chosen = some(rng, nominal.cable_count, 1, 4)
    share = weights(rng, chosen, nominal.cable_count, signed=True)
    return share, places("cable", chosen, nominal.cable_count)


def _all_or_segment(rng: Rng, nominal: Nominal) -> tuple[Array, tuple[str, ...]]:
    """(M,) of 0 and 1 for the cables, and their place."""
    if rng.random() < 0.5:
        return np.ones(nominal.cable_count), ()
    segment = int(rng.integers(nominal.segment_count))
    return _ends_on(nominal, segment).astype(float), (f"segment_{segment + 1}",)


def _ends_on(nominal: Nominal, segment: int) -> NDArray[np.bool_]:
    return np.arange(nominal.cable_count) // nominal.per_segment == segment


def _of_joints(chosen: list[int], count: int) -> Array:
    """(N, 2) of 1 for both axes of the chosen joints."""
    return np.repeat(marked(chosen, count)[:, None], 2, axis=1)


LISTED = MappingProxyType(_DRAWS.by_name)
"""By the name of the effect."""
