"""The effects that verdicts have names for, drawn in the forms that physics offers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.plant.arm import (
    Change,
    Draw,
    RealArm,
    added,
    grown,
    marked,
    places,
    scaled,
    sets,
    sized,
    some,
    turned,
    weights,
)
from cablesense_gap.plant.body import Creep, Nominal, Onset
from cablesense_gap.plant.sensing import Drift, DriftShape, Filter

Rng = np.random.Generator

_CREEP_TIMES = {
    "one time": np.array([1.0]),
    "three times": np.array([0.1, 1.0, 8.0]),
    "logarithmic": np.logspace(-1.5, 1.5, 8),
}


def actuator_backlash(rng: Rng, nominal: Nominal) -> Change:
    """Play in one to four actuators, equal or uneven; where in it each begins is unknown."""
    count = nominal.cable_count
    chosen = some(rng, count, 1, 4)
    uneven = len(chosen) > 1 and rng.random() < 0.5
    uneven_share = weights(rng, chosen, count)
    share = uneven_share if uneven else marked(chosen, count)
    start = rng.uniform(-1.0, 1.0, count)
    return Change(
        "actuator_backlash", "uneven play" if uneven else "equal play", "m", 1e-6, 1e-3,
        sets("actuation", play_m=(scaled, share), play_start=start),
        where=places("cable", chosen, count),
    )  # fmt: skip


def capstan_friction(rng: Rng, nominal: Nominal) -> Change:
    """T2 <= T1 exp(mu theta) at every guide: sharp or rounded, with or without a pulley."""
    onset = Onset.SHARP if rng.random() < 0.5 else Onset.ROUNDED
    spread, pulley = bool(rng.random() < 0.5), bool(rng.random() < 0.4)
    reach_m = 5e-6 if onset is Onset.SHARP else float(np.exp(rng.uniform(*np.log([2e-5, 2e-4]))))
    wrap = float(rng.uniform(0.3, 1.6)) if pulley else 0.0
    stretch = "stretch all along" if spread else "stretch in the run"
    return Change(
        "capstan_friction", f"{onset} onset, {stretch}, {'with' if pulley else 'no'} pulley",
        "1", 0.003, 0.4,
        sets(
            "friction", coefficient=(scaled, np.ones(nominal.cable_count)),
            pulley_rad=wrap, onset=onset, reach_m=reach_m, spread=spread,
        ),
        details={"reach_m": reach_m, "pulley_rad": wrap},
    )  # fmt: skip


def cable_creep(rng: Rng, nominal: Nominal) -> Change:
    """Kelvin-Voigt elements in series: one, three or many times, new cables or settled ones."""
    form = str(rng.choice(list(_CREEP_TIMES)))
    time_s = float(np.exp(rng.uniform(*np.log([8.0, 80.0]))))
    settled = float(rng.choice([0.0, 1.0, rng.uniform()]))
    cables, where = _all_or_segment(rng, nominal)
    times = np.clip(time_s * _CREEP_TIMES[form], 1.0, 2000.0)
    return Change(
        "cable_creep",
        f"{form}, {'new' if settled == 0.0 else 'settled' if settled == 1.0 else 'used'}",
        "of the elastic stretch", 0.01, 1.5,
        partial(_creeping, cables=cables, time_s=times, settled=settled),
        where=where, details={"time_s": time_s, "settled": settled},
    )  # fmt: skip


def _creeping(arm: RealArm, size: float, cables: Array, time_s: Array, settled: float) -> RealArm:
    total = size * cables / arm.body.stiffness_n_m
    compliance = np.tile(total / len(time_s), (len(time_s), 1))
    return replace(arm, creep=Creep(compliance, time_s, settled))


def cable_stiffness(rng: Rng, nominal: Nominal) -> Change:
    """Softer or harder cables, all or those that end on a segment."""
    cables, where = _all_or_segment(rng, nominal)
    softer = bool(rng.random() < 0.5)
    return Change(
        "cable_stiffness", "softer" if softer else "harder",
        "of the nominal", 0.01, 0.5 if softer else 1.5,
        sets("body", stiffness_n_m=(grown, -cables if softer else cables)),
        where=where,
    )  # fmt: skip


def pretension_error(rng: Rng, nominal: Nominal) -> Change:
    """One to all cables tensioned to another value, all by the same or each by its own."""
    count = nominal.cable_count
    chosen = some(rng, count, 1, 4) if rng.random() < 0.7 else some(rng, count, 1, count)
    alike = bool(rng.random() < 0.7)
    own = weights(rng, chosen, count, signed=True)
    share = np.where(own != 0.0, rng.choice([-1.0, 1.0]), 0.0) if alike else own
    least = 0.1 * nominal.pretension_n
    return Change(
        "pretension_error", "all by the same" if alike else "each by its own", "N", 0.3, 30.0,
        sets("body", pretension_n=(_added_above, share, least)),
        where=places("cable", chosen, count),
    )  # fmt: skip


def _added_above(old: Array, size: float, share: Array, least: float) -> Array:
    return np.maximum(old + size * share, least)


def joint_friction(rng: Rng, nominal: Nominal) -> Change:
    """Dry friction in both axes of one, two or all joints: sharp, rounded or Stribeck's."""
    count = nominal.segment_count
    chosen = list(range(count)) if rng.random() < 0.3 else some(rng, count, 1, 2)
    form = str(rng.choice(["sharp", "rounded", "Stribeck"]))
    rounded = form == "rounded"
    reach_rad = float(rng.uniform(5e-4, 3e-3)) if rounded else 1e-4
    breakaway = float(rng.uniform(1.2, 1.8)) if form == "Stribeck" else 1.0
    return Change(
        "joint_friction", form, "N m", 0.005, 2.0,
        sets(
            "friction", joint_nm=(scaled, _of_joints(chosen, count)),
            joint_onset=Onset.ROUNDED if rounded else Onset.SHARP,
            joint_reach_rad=reach_rad, breakaway=breakaway,
        ),
        where=places("joint", chosen, count),
    )  # fmt: skip


def joint_elasticity(rng: Rng, nominal: Nominal) -> Change:
    """Joints that spring back to straight, linearly or hardening a little."""
    count = nominal.segment_count
    one = rng.random() < 0.6
    chosen = [int(rng.integers(count))] if one else list(range(count))
    hardening = float(rng.choice([0.0, rng.uniform(3.0, 15.0)]))
    share = _of_joints(chosen, count)
    return Change(
        "joint_elasticity", "hardening" if hardening else "linear", "N m/rad", 0.05, 80.0,
        sets("body", spring_nm_rad=(scaled, share), hardening_nm_rad3=(scaled, hardening * share)),
        where=places("joint", chosen, count), details={"hardening_rad2": hardening},
    )  # fmt: skip


def payload(rng: Rng, nominal: Nominal) -> Change:
    """A mass on a segment's axis, anywhere along it."""
    segment = int(rng.integers(nominal.segment_count))
    at_m = float(rng.uniform(0.0, nominal.length_m))
    return Change(
        "payload", "point mass", "kg", 0.005, 4.0, partial(_loaded, segment=segment, at_m=at_m),
        where=(f"segment_{segment + 1}",), details={"at_m": at_m},
    )  # fmt: skip


def _loaded(arm: RealArm, size: float, segment: int, at_m: float) -> RealArm:
    body = arm.body
    joint = np.append(body.mass_joint, body.driven[segment])
    at = np.vstack([body.mass_at_m, [at_m, 0.0, 0.0]])
    mass = np.append(body.mass_kg, size)
    return replace(arm, body=replace(body, mass_kg=mass, mass_joint=joint, mass_at_m=at))


def base_tilt(rng: Rng, nominal: Nominal) -> Change:
    """A base that is not level: rolled, pitched or both; loads stay in base axes."""
    form = str(rng.choice(["roll", "pitch", "roll and pitch"]))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    axis = {"roll": (1.0, 0.0), "pitch": (0.0, 1.0)}.get(form, (np.cos(angle), np.sin(angle)))
    sign = float(rng.choice([-1.0, 1.0]))
    x, y = sign * float(axis[0]), sign * float(axis[1])
    return Change(
        "base_tilt", form, "deg", 0.1, 30.0,
        sets("body", gravity_m_s2=(_tilted, (x, y, 0.0))),
        details={"about_x": x, "about_y": y},
    )  # fmt: skip


def _tilted(gravity: Array, size: float, axis: tuple[float, float, float]) -> Array:
    from scipy.spatial.transform import Rotation

    base = Rotation.from_rotvec(np.deg2rad(size) * np.array(axis))
    return np.asarray(base.inv().apply(gravity), dtype=float)


def contact_offset(rng: Rng, nominal: Nominal) -> Change:
    """Loads that act nearer to the base or to the tip, on one segment or on all."""
    count = nominal.segment_count
    one = bool(rng.random() < 0.6)
    segment = int(rng.integers(count))
    shift = marked(segment if one else slice(None), count, rng.choice([-1.0, 1.0]))
    return Change(
        "contact_offset", "one segment" if one else "all segments", "m", 0.0005, 0.05,
        sets("body", contact_at_m=(added, np.outer(shift, [1.0, 0.0, 0.0]))),
        where=(f"segment_{segment + 1}",) if one else (),
        details={"toward_tip": float(shift[segment])},
    )  # fmt: skip


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
    move = _further_out if radius else _turned_deg
    of = "plates of the segment" if carried else "cables that end on the segment"
    return Change(
        "routing_geometry", f"{'radius' if radius else 'angle'}, {of}",
        "m" if radius else "deg", 5e-5 if radius else 0.1, 0.012 if radius else 15.0,
        sets("body", before_m=(move, before), after_m=(move, after)),
        where=(f"segment_{segment + 1}",),
    )  # fmt: skip


def _turned_deg(points_m: Array, size: float, share: Array) -> Array:
    return turned(points_m, np.deg2rad(size * share))


def _further_out(points_m: Array, size: float, share: Array) -> Array:
    moved = points_m.copy()
    radius = np.linalg.norm(moved[..., 1:], axis=-1)
    moved[..., 1:] *= ((radius + size * share) / radius)[..., None]
    return moved


def sensor_gain(rng: Rng, nominal: Nominal) -> Change:
    """Wrong scale on one to four sensors."""
    share, where = _some_sensors(rng, nominal)
    return Change(
        "sensor_gain", "each by its own", "1", 0.001, 0.4,
        sets("sensing", gain=(grown, share)), where=where,
    )  # fmt: skip


def sensor_offset(rng: Rng, nominal: Nominal) -> Change:
    """Zero errors on one to four sensors."""
    share, where = _some_sensors(rng, nominal)
    return Change(
        "sensor_offset", "each by its own", "N", 0.1, 30.0,
        sets("sensing", offset_n=(added, share)), where=where,
    )  # fmt: skip


def sensor_drift(rng: Rng, nominal: Nominal) -> Change:
    """Zeros that drift: steadily, slowly to and fro, at random, or while warming up."""
    count = nominal.cable_count
    chosen = some(rng, count, 1, 4)
    shape = DriftShape(str(rng.choice([str(shape) for shape in DriftShape])))
    time_s = float(rng.uniform(*((60.0, 400.0) if shape is DriftShape.SINE else (20.0, 90.0))))
    share = weights(rng, chosen, count, signed=True)
    phase_rad = float(rng.uniform(0.0, 2.0 * np.pi))
    drift = Drift(share, shape, time_s, phase_rad, int(rng.integers(2**31)))
    return Change(
        "sensor_drift", str(shape), "N", 0.1, 40.0,
        sets("sensing", drift=(sized, drift, "size_n")),
        where=places("cable", chosen, count), details={"time_s": time_s},
    )  # fmt: skip


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
        "sensor_crosstalk",
        "one channel into its neighbours" if one else "all channels into their neighbours",
        "1", 0.0005, 0.3, sets("sensing", leak=(scaled, leak)),
        where=(f"cable_{source + 1}",) if one else (),
    )  # fmt: skip


def sensor_lag(rng: Rng, nominal: Nominal) -> Change:
    """All or some sensors that follow late, through one of three filters."""
    count = nominal.cable_count
    chosen = list(range(count)) if rng.random() < 0.4 else some(rng, count, 1, 4)
    kind = Filter(str(rng.choice([str(kind) for kind in Filter])))
    return Change(
        "sensor_lag", str(kind), "s", 0.01, 8.0,
        sets("sensing", lag_s=(scaled, marked(chosen, count)), lag_filter=kind),
        where=places("cable", chosen, count),
    )  # fmt: skip


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


def _ends_on(nominal: Nominal, segment: int) -> np.ndarray:
    return np.arange(nominal.cable_count) // nominal.per_segment == segment


def _of_joints(chosen: list[int], count: int) -> Array:
    """(N, 2) of 1 for both axes of the chosen joints."""
    return np.repeat(marked(chosen, count)[:, None], 2, axis=1)


_DRAWS: tuple[Draw, ...] = (
    actuator_backlash, base_tilt, cable_creep, cable_stiffness, capstan_friction,
    contact_offset, joint_elasticity, joint_friction, payload, pretension_error,
    routing_geometry, sensor_crosstalk, sensor_drift, sensor_gain, sensor_lag,
    sensor_offset,
)  # fmt: skip
LISTED = MappingProxyType({draw.__name__: draw for draw in _DRAWS})
"""By the name of the effect; the order is part of what a seed makes."""
