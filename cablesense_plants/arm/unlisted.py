"""Effects that verdicts have no name for: what a real arm may have and nobody listed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.arm import ADDED, LIMITED, PAID, REPEATED, SCALED, UNEVEN, RealArm
from cablesense_plants.arm.body import Body, CableContact, TipSpring
from cablesense_plants.arm.listed import ArmChange, ArmDraw, faulty, marked, rotation
from cablesense_plants.cases import UNKNOWN, Draws, added, scaled, sets

UNLISTED = Draws(UNKNOWN)


@UNLISTED.of_size("1", 5e-4, 0.3)
def actuator_ratio(draw: ArmDraw) -> ArmChange:
    """Actuators that pay out more or less than the command."""
    share = draw.weights(draw.cables(1, 3), signed=True)
    return ArmChange(
        faulty("actuation", PAID, lambda size, given, *_: given * (1.0 + size * share))
    )


@UNLISTED.of_size("m", 5e-6, 2e-3)
def clamp_slip(draw: ArmDraw) -> ArmChange:
    """A clamp or two that let cable through at one moment of the recording."""
    share = draw.weights(draw.cables(1, 2))
    slip_s = draw.uniform(60.0, 220.0)

    def slipped(size: float, given_m: Array, _commanded_m: Array, time_s: Array) -> Array:
        return np.asarray(given_m + (time_s >= slip_s)[:, None] * (size * share))

    return ArmChange(faulty("actuation", UNEVEN, slipped))


@UNLISTED.of_size("of the exponent", 0.01, 3.0)
def hardening_cables(draw: ArmDraw) -> ArmChange:
    """Cables stiffer the more they carry, as drawn at the pretension."""
    return ArmChange(sets("body", exponent=added(1.0)))


@UNLISTED.of_size("m", 2e-6, 1e-3)
def screw_error(draw: ArmDraw) -> ArmChange:
    """Screws with an error that repeats every turn."""
    share = draw.weights(draw.cables(2, 6))
    pitch_m = draw.uniform(0.002, 0.006)
    phase = draw.rng.uniform(0.0, 2.0 * np.pi, len(share))

    def uneven(size: float, given_m: Array, commanded_m: Array, _time_s: Array) -> Array:
        turned = 2.0 * np.pi * commanded_m / pitch_m + phase
        return np.asarray(given_m + size * share * (np.sin(turned) - np.sin(phase)))

    return ArmChange(faulty("actuation", UNEVEN, uneven))


@UNLISTED.of_size("m/rad^2", 1e-3, 1.0)
def snagging_cables(draw: ArmDraw) -> ArmChange:
    """Cables that touch and push each other aside where a joint bends one way."""
    joint = draw.segment()
    passing = np.arange(joint * draw.nominal.per_segment, draw.nominal.cable_count)
    pair = tuple(int(c) for c in draw.rng.choice(passing, 2, replace=False))
    pitch = draw.rng.integers(2) == 0
    sign = draw.sign()
    toward = (sign, 0.0) if pitch else (0.0, sign)
    from_rad = draw.uniform(0.0, 0.06)

    def snagging(_old: object, size: float) -> tuple[CableContact]:
        return (CableContact(joint, toward, pair, size, from_rad),)

    return ArmChange(sets("body", cable_contacts=snagging))


@UNLISTED.of_size("rad/(N m)", 1e-4, 0.05)
def limber_segments(draw: ArmDraw) -> ArmChange:
    """Segments that bend in their middle under load."""

    def limber(arm: RealArm, size: float) -> RealArm:
        return replace(arm, body=_with_middles(arm.body, 1.0 / size))

    return ArmChange(limber)


def _with_middles(body: Body, stiffness_nm_rad: float) -> Body:
    """Each joint followed by a sprung one halfway to the next; what hung on it hangs behind.

    The joints of the body have no springs.
    """
    half = 0.5 * np.append(body.spacing_m[1:], body.tip_at_m[0])
    spacing = np.repeat(half, 2)
    spacing[0::2] = np.append(body.spacing_m[0], half[:-1])
    before = np.repeat(body.before_m, 2, axis=0)
    after = np.repeat(body.after_m, 2, axis=0)
    before[1::2] = body.after_m
    before[1::2, :, 0] -= half[:, None]
    after[1:-1:2] = body.before_m[1:]
    after[1:-1:2, :, 0] += half[:-1, None]
    passes = np.repeat(body.passes, 2, axis=0)
    passes[1::2] = np.append(body.passes[1:], np.zeros((1, body.cable_count), dtype=bool), axis=0)
    back = np.outer(half, [1.0, 0.0, 0.0])
    behind = np.array([1, 0, 1, 1])[:, None]  # the joint centre alone stays before the middle
    return replace(
        body,
        spacing_m=spacing,
        before_m=before,
        after_m=after,
        passes=passes,
        skew=np.repeat(body.skew, 2, axis=0),
        mass_joint=2 * body.mass_joint + 1,
        mass_at_m=body.mass_at_m - back[body.mass_joint],
        contact_joint=2 * body.contact_joint + behind,
        contact_at_m=body.contact_at_m - behind[..., None] * back[body.contact_joint],
        tip_at_m=body.tip_at_m - back[-1],
        spring_nm_rad=np.tile([[0.0, 0.0], [stiffness_nm_rad] * 2], (body.joint_count, 1)),
        driven=2 * body.driven,
    )


@UNLISTED.of_size("m", 5e-4, 0.045)
def link_length(draw: ArmDraw) -> ArmChange:
    """A segment that is longer or shorter than drawn, so that the next joint is elsewhere."""
    count = draw.nominal.segment_count
    share = marked(int(draw.rng.integers(min(1, count - 1), count)), count, draw.sign())
    return ArmChange(sets("body", spacing_m=added(share)))


@UNLISTED.of_size("deg", 1.0, 30.0)
def skewed_axes(draw: ArmDraw) -> ArmChange:
    """Joints whose axes are turned against the plates."""
    axes = np.zeros((draw.nominal.segment_count, 3))
    chosen = draw.some(len(axes), 1, 2)
    directions = draw.rng.standard_normal((len(chosen), 3))
    axes[chosen] = directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def turned(_old: Array, size_deg: float) -> Array:
        return np.asarray(rotation(size_deg, axes).as_matrix())

    return ArmChange(sets("body", skew=turned))


@UNLISTED.of_size("N m", 0.005, 3.0)
def cogging(draw: ArmDraw) -> ArmChange:
    """Joints with notches: a torque periodic in their angle."""
    share = np.zeros((draw.nominal.segment_count, 2))
    share[draw.some(len(share), 1, 2)] = 1.0
    per_turn = draw.uniform(40.0, 90.0)
    return ArmChange(sets("body", cogging_nm=scaled(share), cogging_per_turn=per_turn))


@UNLISTED.of_size("N/m", 0.3, 300.0)
def tether(draw: ArmDraw) -> ArmChange:
    """A hose or a band from the arm's end to a point near the arm."""
    angle = draw.uniform(0.0, 2.0 * np.pi)
    away_m = draw.uniform(0.1, 0.4)
    x = _reach_m(draw) + draw.uniform(-0.2, 0.1)
    anchor_m = (x, float(away_m * np.sin(angle)), float(away_m * np.cos(angle)))
    return ArmChange(sets("body", tip_springs=lambda _old, size: (TipSpring(anchor_m, size),)))


@UNLISTED.of_size("N/m", 5.0, 2e4)
def wall(draw: ArmDraw) -> ArmChange:
    """An elastic wall that the arm's end touches on one side."""
    angle = draw.uniform(0.0, 2.0 * np.pi)
    away_m = draw.uniform(0.003, 0.03)
    normal = (0.0, float(np.sin(angle)), float(np.cos(angle)))
    at_m = (_reach_m(draw), away_m * normal[1], away_m * normal[2])
    return ArmChange(sets("body", tip_springs=lambda _old, size: (TipSpring(at_m, size, normal),)))


def _reach_m(draw: ArmDraw) -> float:
    return float(draw.nominal.body.spacing_m[0] + draw.nominal.length_m.sum())


@UNLISTED.of_size("1/N", 2e-5, 0.01)
def sensor_bow(draw: ArmDraw) -> ArmChange:
    """Sensors whose scale changes with the tension."""
    bow = _all_or_some(draw) * draw.sign()
    straight_n = draw.nominal.pretension_n

    def bowed(size: float, signal_n: Array, _time_s: Array) -> Array:
        return signal_n * (1.0 + size * bow * (signal_n - straight_n))

    return ArmChange(faulty("sensing", SCALED, bowed))


@UNLISTED.of_size("N")
def sensor_ceiling(draw: ArmDraw) -> ArmChange:
    """Sensors that softly saturate; the size is how far below five times the pretension."""
    full_n = 5.0 * draw.nominal.pretension_n
    sensors = _all_or_some(draw)

    def limited(size: float, signal_n: Array, _time_s: Array) -> Array:
        ceiling_n = np.where(sensors > 0.0, full_n - size, np.inf)
        over = np.maximum(signal_n - ceiling_n, 0.0)
        return np.where(over > 0.0, ceiling_n + over / (1.0 + over / 10.0), signal_n)

    saturating = faulty("sensing", LIMITED, limited)
    return ArmChange(saturating, least=0.12 * full_n, most=0.78 * full_n)


def _all_or_some(draw: ArmDraw) -> Array:
    """(M,) of 0 and 1 for all sensors or for two to six."""
    chosen = slice(None) if draw.chance(0.5) else draw.cables(2, 6)
    return marked(chosen, draw.nominal.cable_count)


@UNLISTED.of_size("of the rows", 0.01, 0.6)
def sensor_dropouts(draw: ArmDraw) -> ArmChange:
    """Channels that now and then repeat their last value for a while."""
    share = draw.weights(draw.cables(1, 6))
    mean_rows = draw.uniform(8.0, 40.0)
    seed = int(draw.rng.integers(2**31))

    def repeated(size: float, signal_n: Array, _time_s: Array) -> Array:
        rng = np.random.default_rng(seed)
        rows = len(signal_n)
        last = np.tile(np.arange(rows)[:, None], (1, len(share)))
        for channel in np.flatnonzero(share):
            gap = mean_rows * (1.0 / (size * share[channel]) - 1.0)
            start = 1.0 + rng.exponential(gap)
            while start < rows:
                end = start + 1.0 + rng.exponential(mean_rows)
                last[int(start) : int(end), channel] = int(start) - 1
                start = end + 1.0 + rng.exponential(gap)
        return np.take_along_axis(signal_n, last, axis=0)

    return ArmChange(faulty("sensing", REPEATED, repeated))


@UNLISTED.of_size("N", 0.1, 15.0)
def sensor_hum(draw: ArmDraw) -> ArmChange:
    """An interference of a few tenths of a hertz on several channels."""
    share = draw.weights(draw.cables(3, 8))
    hz = draw.uniform(0.15, 0.9)
    phase_rad = draw.uniform(0.0, 2.0 * np.pi)

    def humming(size: float, signal_n: Array, time_s: Array) -> Array:
        return signal_n + size * share * np.sin(2.0 * np.pi * hz * time_s[:, None] + phase_rad)

    return ArmChange(faulty("sensing", ADDED, humming))
