"""The effects that verdicts have names for, drawn in the forms that physics offers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, get_args

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.arm import RealArm, turned
from cablesense_plants.arm.body import Creep
from cablesense_plants.arm.change import (
    ArmChange,
    ArmDraw,
    Draws,
    added,
    grown,
    marked,
    places,
    scaled,
    sets,
    sized,
)
from cablesense_plants.arm.sensing import Drift, DriftShape, Filter

_CREEP_TIMES = {
    "one time": np.array([1.0]),
    "three times": np.array([0.1, 1.0, 8.0]),
    "logarithmic": np.logspace(-1.5, 1.5, 8),
}
_DRAWS = Draws()


@_DRAWS.of_size("m", 1e-6, 1e-3)
def actuator_backlash(draw: ArmDraw) -> ArmChange:
    """Play in one to four actuators, equal or uneven; where in it each begins is unknown."""
    chosen = draw.cables(1, 4)
    uneven = len(chosen) > 1 and draw.chance(0.5)
    share = draw.weights(chosen)
    share = share if uneven else np.sign(share)
    start = draw.rng.uniform(-1.0, 1.0, len(share))
    loose = sets("actuation", play_m=(scaled, share), play_start=start)
    return ArmChange(loose, "uneven play" if uneven else "equal play", places("cable", share))


@_DRAWS.of_size("deg", 0.1, 30.0)
def base_tilt(draw: ArmDraw) -> ArmChange:
    """A base that is not level: rolled, pitched or both; loads stay in base axes."""
    form = draw.one_of(["roll", "pitch", "roll and pitch"])
    angle = draw.uniform(0.0, 2.0 * np.pi)
    axis = {"roll": (1.0, 0.0), "pitch": (0.0, 1.0)}.get(form, (np.cos(angle), np.sin(angle)))
    sign = draw.sign()
    x, y = sign * float(axis[0]), sign * float(axis[1])
    tilted = sets("body", gravity_m_s2=(_tilted, (x, y, 0.0)))
    return ArmChange(tilted, form, details={"about_x": x, "about_y": y})


def _tilted(gravity: Array, size: float, axis: tuple[float, float, float]) -> Array:
    from scipy.spatial.transform import Rotation

    base = Rotation.from_rotvec(np.deg2rad(size) * np.array(axis))
    return np.asarray(base.inv().apply(gravity), dtype=float)


@_DRAWS.of_size("of the elastic stretch", 0.01, 1.5)
def cable_creep(draw: ArmDraw) -> ArmChange:
    """Kelvin-Voigt elements in series: one, three or many times, new cables or settled ones."""
    form = draw.one_of(_CREEP_TIMES)
    time_s = draw.log_uniform(8.0, 80.0)
    settled = float(draw.rng.choice([0.0, 1.0, draw.rng.uniform()]))
    cables, where = _all_or_segment(draw)
    times = np.clip(time_s * _CREEP_TIMES[form], 1.0, 2000.0)
    return ArmChange(
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
def cable_stiffness(draw: ArmDraw) -> ArmChange:
    """Softer or harder cables, all or those that end on a segment."""
    cables, where = _all_or_segment(draw)
    if draw.chance(0.5):
        return ArmChange(sets("body", stiffness_n_m=(grown, -cables)), "softer", where, most=0.5)
    return ArmChange(sets("body", stiffness_n_m=(grown, cables)), "harder", where)


@_DRAWS.of_size("1", 0.003, 0.4)
def capstan_friction(draw: ArmDraw) -> ArmChange:
    """Cables that stick and slide at every guide, with or without a pulley at the actuator.

    They stick rigidly, break away above the friction of sliding, or have bristles that give way
    at once or little by little; all alike, or each cable by up to a fifth more or less.
    """
    onset = draw.one_of(["rigid", "breakaway", "bristles", "rounded bristles"])
    uneven, pulley = draw.chance(0.4), draw.chance(0.5)
    count = draw.nominal.cable_count
    share = draw.rng.uniform(0.8, 1.2, count) if uneven else np.ones(count)
    numbers = {
        "breakaway": draw.uniform(1.15, 1.5) if onset == "breakaway" else 1.0,
        "pulley_rad": draw.uniform(0.3, 1.6) if pulley else 0.0,
        "reach_m": draw.log_uniform(1e-5, 1e-4) if "bristles" in onset else 0.0,
        "actuator_share": draw.uniform(0.1, 0.4),
    }
    return ArmChange(
        sets(
            "friction", coefficient=(scaled, share), rounded=onset == "rounded bristles", **numbers
        ),
        f"{onset}, {'uneven' if uneven else 'even'}, {'with' if pulley else 'no'} pulley",
        details=numbers,
    )


@_DRAWS.of_size("m", 0.0005, 0.05)
def contact_offset(draw: ArmDraw) -> ArmChange:
    """Loads that act nearer to the base or to the tip, on one segment or on all."""
    one = draw.chance(0.6)
    segment = draw.segment()
    shift = marked(segment if one else slice(None), draw.nominal.segment_count, draw.sign())
    return ArmChange(
        sets("body", contact_at_m=(added, np.outer(shift, [1.0, 0.0, 0.0]))),
        "one segment" if one else "all segments",
        places("segment", shift),
        {"toward_tip": float(shift[segment])},
    )


@_DRAWS.of_size("N m/rad", 0.05, 80.0)
def joint_elasticity(draw: ArmDraw) -> ArmChange:
    """Joints that spring back to straight, linearly or hardening a little."""
    chosen: Any = draw.segment() if draw.chance(0.6) else slice(None)
    hardening = float(draw.rng.choice([0.0, draw.rng.uniform(3.0, 15.0)]))
    share = _both_axes(chosen, draw)
    return ArmChange(
        sets("body", spring_nm_rad=(scaled, share), hardening_nm_rad3=(scaled, hardening * share)),
        "hardening" if hardening else "linear",
        places("joint", share[:, 0]),
        {"hardening_rad2": hardening},
    )


@_DRAWS.of_size("N m", 0.005, 2.0)
def joint_friction(draw: ArmDraw) -> ArmChange:
    """Dry friction in both axes of one, two or all joints: sharp, rounded or Stribeck's."""
    count = draw.nominal.segment_count
    share = _both_axes(slice(None) if draw.chance(0.3) else draw.some(count, 1, 2), draw)
    form = draw.one_of(["sharp", "rounded", "Stribeck"])
    rounded = form == "rounded"
    reach_rad = draw.uniform(5e-4, 3e-3) if rounded else 1e-4
    breakaway = draw.uniform(1.2, 1.8) if form == "Stribeck" else 1.0
    rough = sets(
        "friction", joint_nm=(scaled, share), joint_rounded=rounded, joint_reach_rad=reach_rad,
        joint_breakaway=breakaway,
    )  # fmt: skip
    return ArmChange(rough, form, places("joint", share[:, 0]))


@_DRAWS.of_size("deg")
def load_cell(draw: ArmDraw) -> ArmChange:
    """A load cell that is turned against the base, of the wrong scale, or both."""
    form = draw.one_of(["axes", "scale", "axes and scale"])
    axis = np.array([1.0, 0.0, 0.0]) * draw.sign() + draw.rng.uniform(-0.4, 0.4, 3)
    sign = draw.sign()
    if form == "scale":
        return ArmChange(partial(_load_scaled, sign=sign), form, unit="1", least=0.003, most=0.5)
    per_deg = sign * draw.uniform(0.005, 0.02) if form == "axes and scale" else 0.0
    turned_ = partial(_load_turned, axis=axis / np.linalg.norm(axis), per_deg=per_deg)
    return ArmChange(turned_, form, details={"scale_per_deg": per_deg}, least=0.3, most=25.0)


def _load_turned(arm: RealArm, size: float, axis: Array, per_deg: float) -> RealArm:
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(np.deg2rad(size) * axis).as_matrix()
    return replace(arm, load_turn=(1.0 + size * per_deg) * turn @ arm.load_turn)


def _load_scaled(arm: RealArm, size: float, sign: float) -> RealArm:
    return replace(arm, load_turn=(1.0 + sign * size) * arm.load_turn)


@_DRAWS.of_size("kg", 0.005, 4.0)
def payload(draw: ArmDraw) -> ArmChange:
    """A mass on a segment's axis, anywhere along it."""
    segment = draw.segment()
    at_m = draw.uniform(0.0, float(draw.nominal.length_m[segment]))
    loaded = partial(_loaded, segment=segment, at_m=at_m)
    return ArmChange(loaded, "point mass", (f"segment_{segment + 1}",), {"at_m": at_m})


def _loaded(arm: RealArm, size: float, segment: int, at_m: float) -> RealArm:
    body = arm.body
    joint = np.append(body.mass_joint, body.driven[segment])
    at = np.vstack([body.mass_at_m, [at_m, 0.0, 0.0]])
    mass = np.append(body.mass_kg, size)
    return replace(arm, body=replace(body, mass_kg=mass, mass_joint=joint, mass_at_m=at))


@_DRAWS.of_size("N", 0.3, 30.0)
def pretension_error(draw: ArmDraw) -> ArmChange:
    """One to all cables tensioned to another value, all by the same or each by its own."""
    chosen = draw.cables(1, 4 if draw.chance(0.7) else draw.nominal.cable_count)
    alike = draw.chance(0.7)
    share = draw.weights(chosen, signed=True)
    if alike:
        share = np.where(share != 0.0, draw.sign(), 0.0)
    least = 0.1 * draw.nominal.pretension_n
    tensioned = sets("body", pretension_n=(_added_above, share, least))
    form = "all by the same" if alike else "each by its own"
    return ArmChange(tensioned, form, places("cable", share))


def _added_above(old: Array, size: float, share: Array, least: float) -> Array:
    return np.maximum(old + size * share, least)


@_DRAWS.of_size("deg", 0.1, 15.0)
def routing_geometry(draw: ArmDraw) -> ArmChange:
    """A segment's holes on another radius or at another angle, by either reading of "a segment's".

    Those of the cables that end on it, in every plate they pass; or those of all cables in the
    two plates that the segment carries.
    """
    segment = draw.segment()
    radius, carried = draw.chance(0.5), draw.chance(0.4)
    sign = draw.sign()
    before, after = np.zeros((2, draw.nominal.segment_count, draw.nominal.cable_count))
    if carried:
        after[segment] = sign
        before[segment + 1 : segment + 2] = sign
    else:
        own = np.arange(draw.nominal.cable_count) // draw.nominal.per_segment == segment
        before[:, own] = after[:, own] = sign
    of = "plates of the segment" if carried else "cables that end on the segment"
    where = (f"segment_{segment + 1}",)
    if radius:
        moved = sets("body", before_m=(_further_out, before), after_m=(_further_out, after))
        return ArmChange(moved, f"radius, {of}", where, unit="m", least=5e-5, most=0.012)
    moved = sets("body", before_m=(_turned_deg, before), after_m=(_turned_deg, after))
    return ArmChange(moved, f"angle, {of}", where)


def _turned_deg(points_m: Array, size: float, share: Array) -> Array:
    return turned(points_m, np.deg2rad(size * share))


def _further_out(points_m: Array, size: float, share: Array) -> Array:
    moved = points_m.copy()
    radius = np.linalg.norm(moved[..., 1:], axis=-1)
    moved[..., 1:] *= ((radius + size * share) / radius)[..., None]
    return moved


@_DRAWS.of_size("1", 0.0005, 0.3)
def sensor_crosstalk(draw: ArmDraw) -> ArmChange:
    """A share of one channel in its neighbours, or of every channel in its neighbours.

    The place is the channel whose signal leaks.
    """
    count = draw.nominal.cable_count
    one = draw.chance(0.6)
    chosen = int(draw.rng.integers(count))
    source = marked(chosen if one else slice(None), count)
    leak = (np.eye(count, k=1) + np.eye(count, k=-1)) * source
    leak = leak * float(draw.rng.choice([-1.0, 1.0], p=[0.2, 0.8]))
    form = "one channel into its neighbours" if one else "all channels into their neighbours"
    return ArmChange(sets("sensing", leak=(scaled, leak)), form, places("cable", source))


@_DRAWS.of_size("N", 0.1, 40.0)
def sensor_drift(draw: ArmDraw) -> ArmChange:
    """Zeros that drift: steadily, slowly to and fro, at random, or while warming up."""
    chosen = draw.cables(1, 4)
    shape: Any = draw.one_of(get_args(DriftShape))
    time_s = draw.uniform(60.0, 400.0) if shape == "slow sine" else draw.uniform(20.0, 90.0)
    share = draw.weights(chosen, signed=True)
    phase_rad = draw.uniform(0.0, 2.0 * np.pi)
    drift = Drift(share, shape, time_s, phase_rad, int(draw.rng.integers(2**31)))
    drifting = sets("sensing", drift=(sized, drift, "size_n"))
    return ArmChange(drifting, shape, places("cable", share), {"time_s": time_s})


@_DRAWS.of_size("1", 0.001, 0.4)
def sensor_gain(draw: ArmDraw) -> ArmChange:
    """Wrong scale on one to four sensors."""
    share = draw.weights(draw.cables(1, 4), signed=True)
    return ArmChange(
        sets("sensing", gain=(grown, share)), "each by its own", places("cable", share)
    )


@_DRAWS.of_size("s", 0.01, 8.0)
def sensor_lag(draw: ArmDraw) -> ArmChange:
    """All or some sensors that follow late, through one of three filters."""
    chosen: Any = slice(None) if draw.chance(0.4) else draw.cables(1, 4)
    late = marked(chosen, draw.nominal.cable_count)
    kind = draw.one_of(get_args(Filter))
    lagging = sets("sensing", lag_s=(scaled, late), lag_filter=kind)
    return ArmChange(lagging, kind, places("cable", late))


@_DRAWS.of_size("N", 0.1, 30.0)
def sensor_offset(draw: ArmDraw) -> ArmChange:
    """Zero errors on one to four sensors."""
    share = draw.weights(draw.cables(1, 4), signed=True)
    shifted = sets("sensing", offset_n=(added, share))
    return ArmChange(shifted, "each by its own", places("cable", share))


def _all_or_segment(draw: ArmDraw) -> tuple[Array, tuple[str, ...]]:
    """(M,) of 0 and 1 for all cables or those of a segment, and their place."""
    count, per_segment = draw.nominal.cable_count, draw.nominal.per_segment
    if draw.chance(0.5):
        return np.ones(count), ()
    segment = draw.segment()
    own = np.arange(count) // per_segment == segment
    return own.astype(float), (f"segment_{segment + 1}",)


def _both_axes(chosen: Any, draw: ArmDraw) -> Array:
    """(N, 2) of 1 for both axes of the chosen joints."""
    return np.repeat(marked(chosen, draw.nominal.segment_count)[:, None], 2, axis=1)


LISTED = _DRAWS.by_name
"""By the name of the effect."""
