"""Effects that verdicts have no name for: what a real arm may have and nobody listed."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.plant.arm import RealArm
from cablesense_gap.plant.body import Body, CableContact, Nominal, TipSpring
from cablesense_gap.plant.change import (
    UNKNOWN,
    Change,
    Draws,
    added,
    marked,
    scaled,
    sets,
    sized,
    some,
    weights,
)
from cablesense_gap.plant.sensing import Dropouts

Rng = np.random.Generator

_DRAWS = Draws(UNKNOWN)


@_DRAWS.of_size("1", 5e-4, 0.3)
def actuator_ratio(rng: Rng, nominal: Nominal) -> Change:
    """Actuators that pay out more or less than is commanded."""
    count = nominal.cable_count
    share = weights(rng, some(rng, count, 1, 3), count, signed=True)
    return Change(sets("actuation", ratio=(added, share)))


@_DRAWS.of_size("m", 5e-6, 2e-3)
def clamp_slip(rng: Rng, nominal: Nominal) -> Change:
    """A clamp or two that let cable through at one moment of the recording."""
    count = nominal.cable_count
    share = weights(rng, some(rng, count, 1, 2), count)
    time_s = float(rng.uniform(60.0, 220.0))
    return Change(sets("actuation", slip_m=(scaled, share), slip_time_s=time_s))


@_DRAWS.of_size("of the exponent", 0.01, 3.0)
def hardening_cables(rng: Rng, nominal: Nominal) -> Change:
    """Cables stiffer the more they carry, as drawn at the pretension."""
    return Change(sets("body", exponent=(added, 1.0)))


@_DRAWS.of_size("m", 2e-6, 1e-3)
def screw_error(rng: Rng, nominal: Nominal) -> Change:
    """Screws with an error that repeats every turn."""
    count = nominal.cable_count
    share = weights(rng, some(rng, count, 2, 6), count)
    pitch_m = float(rng.uniform(0.002, 0.006))
    phase_rad = rng.uniform(0.0, 2.0 * np.pi, count)
    screw = {"screw_pitch_m": pitch_m, "screw_phase_rad": phase_rad}
    return Change(sets("actuation", screw_m=(scaled, share), **screw))


@_DRAWS.of_size("m/rad^2", 1e-3, 1.0)
def snagging_cables(rng: Rng, nominal: Nominal) -> Change:
    """Cables that touch and push each other aside where a joint bends one way."""
    joint = int(rng.integers(nominal.segment_count))
    passing = np.arange(joint * nominal.per_segment, nominal.cable_count)
    pair = tuple(int(c) for c in rng.choice(passing, 2, replace=False))
    axis = int(rng.integers(2))
    sign = float(rng.choice([-1.0, 1.0]))
    toward = (sign, 0.0) if axis == 0 else (0.0, sign)
    contact = CableContact(joint, toward, pair, 1.0, float(rng.uniform(0.0, 0.06)))
    return Change(sets("body", cable_contacts=(sized, contact, "depth_m_rad2")))


@_DRAWS.of_size("rad/(N m)", 1e-4, 0.05)
def limber_segments(rng: Rng, nominal: Nominal) -> Change:
    """Segments that bend in their middle under what they carry."""
    return Change(_limber)


def _limber(arm: RealArm, size: float) -> RealArm:
    return replace(arm, body=_with_middles(arm.body, 1.0 / size))


def _with_middles(body: Body, stiffness_nm_rad: float) -> Body:
    """Each joint followed by a sprung one halfway to the next; what hung on it hangs behind.

    The joints of the body have no springs.
    """
    half = 0.5 * np.append(body.spacing_m[1:], body.tip_at_m[0])
    spacing = np.repeat(half, 2)
    spacing[0::2] = np.append(body.spacing_m[0], half[:-1])
    before, after = np.repeat(body.before_m, 2, axis=0), np.repeat(body.after_m, 2, axis=0)
    before[1::2] = body.after_m
    before[1::2, :, 0] -= half[:, None]
    after[1:-1:2] = body.before_m[1:]
    after[1:-1:2, :, 0] += half[:-1, None]
    passes = np.repeat(body.passes, 2, axis=0)
    passes[1::2] = np.append(body.passes[1:], np.zeros((1, body.cable_count), dtype=bool), axis=0)
    back = np.outer(half, [1.0, 0.0, 0.0])
    return replace(
        body,
        spacing_m=spacing,
        before_m=before,
        after_m=after,
        passes=passes,
        skew=np.repeat(body.skew, 2, axis=0),
        mass_joint=2 * body.mass_joint + 1,
        mass_at_m=body.mass_at_m - back[body.mass_joint],
        contact_joint=2 * body.contact_joint + 1,
        contact_at_m=body.contact_at_m - back[body.contact_joint],
        tip_at_m=body.tip_at_m - back[-1],
        spring_nm_rad=np.tile([[0.0, 0.0], [stiffness_nm_rad] * 2], (body.joint_count, 1)),
        driven=2 * body.driven,
    )


@_DRAWS.of_size("m", 5e-4, 0.045)
def link_length(rng: Rng, nominal: Nominal) -> Change:
    """A segment that is longer or shorter than drawn, so that the next joint is elsewhere."""
    joint = int(rng.integers(1, nominal.segment_count))
    share = marked(joint, nominal.segment_count, rng.choice([-1.0, 1.0]))
    return Change(sets("body", spacing_m=(added, share)))


@_DRAWS.of_size("deg", 1.0, 30.0)
def skewed_axes(rng: Rng, nominal: Nominal) -> Change:
    """Joints whose axes are turned against the plates."""
    vector = np.zeros((nominal.segment_count, 3))
    chosen = some(rng, nominal.segment_count, 1, 2)
    directions = rng.standard_normal((len(chosen), 3))
    vector[chosen] = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return Change(sets("body", skew=(_rotations, vector)))


def _rotations(_old: Array, size_deg: float, axis: Array) -> Array:
    """(..., 3, 3) turns about axes (..., 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(np.deg2rad(size_deg) * axis).as_matrix(), dtype=float)


@_DRAWS.of_size("N m", 0.005, 3.0)
def cogging(rng: Rng, nominal: Nominal) -> Change:
    """Joints with notches: a torque periodic in their angle."""
    share = np.zeros((nominal.segment_count, 2))
    share[some(rng, nominal.segment_count, 1, 2)] = 1.0
    per_turn = float(rng.uniform(40.0, 90.0))
    return Change(sets("body", cogging_nm=(scaled, share), cogging_per_turn=per_turn))


@_DRAWS.of_size("N/m", 0.3, 300.0)
def tether(rng: Rng, nominal: Nominal) -> Change:
    """A hose or a band from the arm's end to somewhere beside it."""
    angle, away_m = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.1, 0.4)
    x = float(_reach_m(nominal) + rng.uniform(-0.2, 0.1))
    anchor = (x, float(away_m * np.sin(angle)), float(away_m * np.cos(angle)))
    return Change(sets("body", tip_springs=(sized, TipSpring(anchor, 1.0), "stiffness_n_m")))


@_DRAWS.of_size("N/m", 5.0, 2e4)
def wall(rng: Rng, nominal: Nominal) -> Change:
    """An elastic wall that the arm's end touches on one side."""
    angle, away_m = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.003, 0.03)
    normal = (0.0, float(np.sin(angle)), float(np.cos(angle)))
    anchor = (_reach_m(nominal), away_m * normal[1], away_m * normal[2])
    spring = (sized, TipSpring(anchor, 1.0, normal), "stiffness_n_m")
    return Change(sets("body", tip_springs=spring))


def _reach_m(nominal: Nominal) -> float:
    return nominal.plate_offset_m + nominal.segment_count * nominal.length_m


@_DRAWS.of_size("deg", 0.3, 40.0)
def load_direction(rng: Rng, nominal: Nominal) -> Change:
    """A load frame that is turned against the base: loads do not point as they are labelled."""
    vector = np.array([1.0, 0.0, 0.0]) * rng.choice([-1.0, 1.0]) + rng.uniform(-0.4, 0.4, 3)
    return Change(partial(_load_turned, vector=vector))


def _load_turned(arm: RealArm, size: float, vector: Array) -> RealArm:
    turn = _rotations(arm.load_turn, size, vector / np.linalg.norm(vector))
    return replace(arm, load_turn=turn @ arm.load_turn)


@_DRAWS.of_size("1", 0.003, 0.5)
def load_scale(rng: Rng, nominal: Nominal) -> Change:
    """A load cell of the wrong scale: loads are weaker or stronger than written down."""
    return Change(partial(_load_scaled, sign=float(rng.choice([-1.0, 1.0]))))


def _load_scaled(arm: RealArm, size: float, sign: float) -> RealArm:
    return replace(arm, load_turn=(1.0 + sign * size) * arm.load_turn)


@_DRAWS.of_size("1/N", 2e-5, 0.01)
def sensor_bow(rng: Rng, nominal: Nominal) -> Change:
    """Sensors whose scale changes with the tension."""
    count = nominal.cable_count
    bow = marked(_all_or_some(rng, count), count, rng.choice([-1.0, 1.0]))
    return Change(sets("sensing", bow_per_n=(scaled, bow)))


@_DRAWS.of_size("N")
def sensor_ceiling(rng: Rng, nominal: Nominal) -> Change:
    """Sensors or amplifiers that saturate; the size is how far below five times the pretension."""
    full_n = 5.0 * nominal.pretension_n
    sensors = marked(_all_or_some(rng, nominal.cable_count), nominal.cable_count)
    ceiling = sets("sensing", ceiling_n=(_ceiling, sensors, full_n))
    return Change(ceiling, least=0.12 * full_n, most=0.78 * full_n)


def _ceiling(old: Array, size: float, sensors: Array, full_n: float) -> Array:
    return np.where(sensors > 0.0, full_n - size, old)


@_DRAWS.of_size("of the rows", 0.01, 0.6)
def sensor_dropouts(rng: Rng, nominal: Nominal) -> Change:
    """Channels that now and then repeat their last value for a while."""
    count = nominal.cable_count
    share = weights(rng, some(rng, count, 1, 6), count)
    dropouts = Dropouts(share, float(rng.uniform(8.0, 40.0)), int(rng.integers(2**31)))
    return Change(sets("sensing", dropouts=(sized, dropouts, "share")))


@_DRAWS.of_size("N", 0.1, 15.0)
def sensor_hum(rng: Rng, nominal: Nominal) -> Change:
    """An interference of a few tenths of a hertz on several channels."""
    count = nominal.cable_count
    share = weights(rng, some(rng, count, 3, 8), count)
    hz = float(rng.uniform(0.15, 0.9))
    phase_rad = np.full(count, rng.uniform(0.0, 2.0 * np.pi))
    return Change(sets("sensing", hum_n=(scaled, share), hum_hz=hz, hum_phase_rad=phase_rad))


def _all_or_some(rng: Rng, count: int) -> list[int]:
    return list(range(count)) if rng.random() < 0.5 else some(rng, count, 2, 6)


UNLISTED = MappingProxyType(_DRAWS.by_name)
"""By the form of the change."""
