"""Effects that verdicts have no name for: what a real arm may have and nobody listed.

What is wrong with the measurement itself: of the loads, and of the tensions.

The arm's structure: segments that bend, that are longer than drawn, axes that are skewed.

What acts on the arm from outside, and from inside its joints.

Between actuator and segment: wrong ratios, uneven screws, slipping clamps, odd cables.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np

from cablesense_gap.plant.arm import RealArm
from cablesense_gap.plant.body import Body, Nominal, Snag, TipSpring
from cablesense_gap.plant.changes import Change, Draw, some, weights
from cablesense_gap.plant.rubbing import firm, smooth
from cablesense_gap.plant.sensing import Freezing


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


def limber_segments(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Segments that bend in their middle under what they carry."""
    del rng, nominal
    return Change("unknown", "limber_segments", "rad/(N m)", 1e-4, 0.05, _limber)


def _limber(arm: RealArm, size: float) -> RealArm:
    body = _with_middles(arm.body, 1.0 / size)
    return replace(arm, body=body, rubbing=smooth(body), creep=firm(body))


def _with_middles(body: Body, stiffness_nm_rad: float) -> Body:
    """Each joint followed by a sprung one halfway to the next; what hung on it hangs behind."""
    count = body.joint_count
    ends = np.append(body.spacing_m[1:], body.tip_at_m[0])
    half = 0.5 * ends
    spacing = np.empty(2 * count)
    spacing[0::2] = np.append(body.spacing_m[0], half[:-1])
    spacing[1::2] = half
    before = np.repeat(body.before_m, 2, axis=0)
    after = np.repeat(body.after_m, 2, axis=0)
    before[1::2], after[1::2] = body.after_m, body.after_m
    before[1::2, :, 0] -= half[:, None]
    after[1:-1:2] = body.before_m[1:]
    after[1:-1:2, :, 0] += half[:-1, None]
    passes = np.zeros((2 * count, body.cable_count), dtype=bool)
    passes[0::2] = body.passes
    passes[1:-1:2] = body.passes[1:]
    spring = np.zeros((2 * count, 2))
    spring[1::2] = stiffness_nm_rad
    back = np.zeros((count, 3))
    back[:, 0] = half

    def doubled(values: np.ndarray) -> np.ndarray:
        wide = np.zeros((2 * count, *values.shape[1:]))
        wide[0::2] = values
        return wide

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
        spring_nm_rad=doubled(body.spring_nm_rad) + spring,
        hardening_nm_rad3=doubled(body.hardening_nm_rad3),
        cogging_nm=doubled(body.cogging_nm),
        driven=2 * body.driven,
    )


def link_length(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A segment that is longer or shorter than drawn, so that the next joint is elsewhere."""
    joint = int(rng.integers(1, nominal.segment_count))
    sign = float(rng.choice([-1.0, 1.0]))
    return Change(
        "unknown", "link_length", "m", 5e-4, 0.045, partial(_longer, joint=joint, sign=sign)
    )


def _longer(arm: RealArm, size: float, joint: int, sign: float) -> RealArm:
    spacing = arm.body.spacing_m.copy()
    spacing[joint] += sign * size
    return replace(arm, body=replace(arm.body, spacing_m=spacing))


def skewed_axes(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Joints whose axes are turned against the plates."""
    vector = np.zeros((nominal.segment_count, 3))
    chosen = some(rng, nominal.segment_count, 1, 2)
    directions = rng.standard_normal((len(chosen), 3))
    vector[chosen] = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return Change("unknown", "skewed_axes", "deg", 1.0, 30.0, partial(_skewed, vector=vector))


def _skewed(arm: RealArm, size: float, vector: np.ndarray) -> RealArm:
    from scipy.spatial.transform import Rotation

    skew = Rotation.from_rotvec(np.deg2rad(size) * vector).as_matrix()
    return replace(arm, body=replace(arm.body, skew=skew))


def cogging(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Joints with notches: a torque periodic in their angle."""
    share = np.zeros((nominal.segment_count, 2))
    share[some(rng, nominal.segment_count, 1, 2)] = 1.0
    per_turn = float(rng.uniform(40.0, 90.0))
    return Change(
        "unknown", "cogging", "N m", 0.005, 3.0, partial(_cogging, share=share, per_turn=per_turn)
    )


def _cogging(arm: RealArm, size: float, share: np.ndarray, per_turn: float) -> RealArm:
    body = replace(arm.body, cogging_nm=size * share, cogging_per_turn=per_turn)
    return replace(arm, body=body)


def tether(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A hose or a band from the arm's end to somewhere beside it."""
    reach = nominal.plate_offset_m + nominal.segment_count * nominal.length_m
    angle, away_m = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.1, 0.4)
    anchor = (
        float(reach + rng.uniform(-0.2, 0.1)),
        float(away_m * np.sin(angle)),
        float(away_m * np.cos(angle)),
    )
    spring = TipSpring(anchor, 1.0)
    return Change("unknown", "tether", "N/m", 0.3, 300.0, partial(_touched, spring=spring))


def wall(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Something springy that the arm's end runs against on one side."""
    reach = nominal.plate_offset_m + nominal.segment_count * nominal.length_m
    angle, away_m = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.003, 0.03)
    normal = (0.0, float(np.sin(angle)), float(np.cos(angle)))
    anchor = (reach, away_m * normal[1], away_m * normal[2])
    spring = TipSpring(anchor, 1.0, normal)
    return Change("unknown", "wall", "N/m", 5.0, 2e4, partial(_touched, spring=spring))


def _touched(arm: RealArm, size: float, spring: TipSpring) -> RealArm:
    springs = (replace(spring, stiffness_n_m=size),)
    return replace(arm, body=replace(arm.body, tip_springs=springs))


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


UNLISTED: Mapping[str, Draw] = MappingProxyType(
    {
        "actuator_ratio": actuator_ratio,
        "clamp_slip": clamp_slip,
        "hardening_cables": hardening_cables,
        "screw_error": screw_error,
        "snagging_cables": snagging_cables,
        "limber_segments": limber_segments,
        "link_length": link_length,
        "skewed_axes": skewed_axes,
        "cogging": cogging,
        "tether": tether,
        "wall": wall,
        "load_direction": load_direction,
        "load_scale": load_scale,
        "sensor_bow": sensor_bow,
        "sensor_ceiling": sensor_ceiling,
        "sensor_dropouts": sensor_dropouts,
        "sensor_hum": sensor_hum,
    }
)
