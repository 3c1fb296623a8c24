"""Draws of changes of an arm, and the effects that verdicts have names for.

Each effect is drawn in the forms that physics offers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.arm import ADDED, LATE, LEAKED, SCALED, TAKEN_UP, RealArm, turned
from cablesense_plants.arm.body import Nominal
from cablesense_plants.arm.friction import Creep
from cablesense_plants.cases import Draw, Draws, HiddenChange, added, scaled, sets

ArmChange = HiddenChange[RealArm]
Change = Callable[[RealArm, float], RealArm]


@dataclass(frozen=True)
class ArmDraw(Draw):
    """Random draws of changes of an arm as drawn; its M cables count from 0."""

    nominal: Nominal

    def segment(self) -> int:
        """A segment or its joint, from 0."""
        return int(self.rng.integers(self.nominal.segment_count))

    def some(self, count: int, least: int, most: int) -> list[int]:
        """Between `least` and `most` of the positions below `count`, ascending."""
        number = int(self.rng.integers(least, min(most, count) + 1))
        return sorted(int(i) for i in self.rng.choice(count, number, replace=False))

    def cables(self, least: int, most: int) -> list[int]:
        """Between `least` and `most` of the cables, ascending."""
        return self.some(self.nominal.cable_count, least, most)

    def weights(self, chosen: list[int], signed: bool = False) -> Array:
        """(M,) of 0, and of numbers between 0.5 and 1 at the chosen; one is 1 or -1."""
        weights = np.zeros(self.nominal.cable_count)
        drawn = self.rng.uniform(0.5, 1.0, len(chosen))
        drawn /= drawn.max()
        weights[chosen] = drawn * self.rng.choice([-1.0, 1.0], len(drawn)) if signed else drawn
        return weights


def faulty(part: str, stage: int, law: Callable[..., Array]) -> Change:
    """Adds a fault to `actuation` or `sensing`, whose law takes its size before all else."""
    return sets(**{part: lambda old, size: (*old, (stage, partial(law, size)))})


def places(kind: str, marks: Array) -> tuple[str, ...]:
    """Names of the places, counted from 0, where marks are not 0; none where they are all."""
    return () if marks.all() else tuple(f"{kind}_{i + 1}" for i in np.flatnonzero(marks))


def marked(positions: Any, count: int, value: float = 1.0) -> Array:
    """(count,) of 0, and of a value at the positions."""
    marks = np.zeros(count)
    marks[positions] = value
    return marks


_CREEP_TIMES = {
    "one time": np.array([1.0]),
    "three times": np.array([0.1, 1.0, 8.0]),
    "logarithmic": np.logspace(-1.5, 1.5, 8),
}
_SHAPES_OF_DRIFT = ("linear", "slow sine", "random walk", "warm-up")
FILTERS = ("first order", "moving average", "second order, critically damped")
_FINE = 10
"""Samples of a filter between two readings."""
LISTED = Draws()


@LISTED.of_size("m", 1e-6, 1e-3)
def actuator_backlash(draw: ArmDraw) -> ArmChange:
    """Play in one to four actuators, equal or uneven; where in it each begins is unknown."""
    chosen = draw.cables(1, 4)
    uneven = len(chosen) > 1 and draw.chance(0.5)
    share = draw.weights(chosen)
    share = share if uneven else np.sign(share)
    start = draw.rng.uniform(-1.0, 1.0, len(share))
    loose = faulty(
        "actuation", TAKEN_UP, lambda size, given, *_: with_play_m(given, size * share, start)
    )
    return ArmChange(loose, "uneven play" if uneven else "equal play", places("cable", share))


def with_play_m(given_m: Array, play_m: Array, start: Array) -> Array:
    """(R, M) lengths behind play (M,), from end to end, that begins at `start`, -1 to 1, in it."""
    half = 0.5 * play_m
    moved = given_m.copy()
    behind_m = given_m[0] + half * start
    for row in moved:
        row[:] = behind_m = np.clip(behind_m, row - half, row + half)
    return moved


@LISTED.of_size("deg", 0.1, 30.0)
def base_tilt(draw: ArmDraw) -> ArmChange:
    """A base that is not level: rolled, pitched or both; loads stay in base axes."""
    form = draw.one_of(["roll", "pitch", "roll and pitch"])
    angle = draw.uniform(0.0, 2.0 * np.pi)
    axis = {"roll": (1.0, 0.0), "pitch": (0.0, 1.0)}.get(form, (np.cos(angle), np.sin(angle)))
    sign = draw.sign()
    x = sign * float(axis[0])
    y = sign * float(axis[1])

    def tilted(gravity: Array, size: float) -> Array:
        return np.asarray(rotation(size, np.array((x, y, 0.0))).inv().apply(gravity))

    return ArmChange(sets("body", gravity_m_s2=tilted), form, details={"about_x": x, "about_y": y})


def rotation(size_deg: float, axis: Array) -> Any:
    """Turns about axes (..., 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(np.deg2rad(size_deg) * axis)


@LISTED.of_size("of the elastic stretch", 0.01, 1.5)
def cable_creep(draw: ArmDraw) -> ArmChange:
    """Kelvin-Voigt elements in series: one, three or many times, new cables or settled ones."""
    form = draw.one_of(_CREEP_TIMES)
    time_s = _log_uniform(draw, 8.0, 80.0)
    settled = float(draw.rng.choice([0.0, 1.0, draw.rng.uniform()]))
    cables, where = _all_or_segment(draw)
    times = np.clip(time_s * _CREEP_TIMES[form], 1.0, 2000.0)

    def creeping(arm: RealArm, size: float) -> RealArm:
        total = size * cables / arm.body.stiffness_n_m
        compliance = np.tile(total / len(times), (len(times), 1))
        return replace(arm, creep=Creep(compliance, times, settled))

    state = "new" if settled == 0.0 else "settled" if settled == 1.0 else "used"
    return ArmChange(creeping, f"{form}, {state}", where, {"time_s": time_s, "settled": settled})


@LISTED.of_size("of the nominal", 0.01, 1.5)
def cable_stiffness(draw: ArmDraw) -> ArmChange:
    """Softer or harder cables, all or those that end on a segment."""
    cables, where = _all_or_segment(draw)
    softer = draw.chance(0.5)
    by = -cables if softer else cables
    changed = sets("body", stiffness_n_m=lambda old, size: old * (1.0 + size * by))
    form, most = ("softer", 0.5) if softer else ("harder", 0.0)
    return ArmChange(changed, form, where, most=most)


@LISTED.of_size("1", 0.003, 0.4)
def capstan_friction(draw: ArmDraw) -> ArmChange:
    """Cables that stick and slide at every guide, with or without a pulley at the actuator.

    They stick rigidly, break away above the friction of sliding, or have bristles that give way
    at once or little by little; all alike, or each cable by up to a fifth more or less. The arm
    has moved before, or was just tensioned without its weight.
    """
    onset = draw.one_of(["rigid", "breakaway", "bristles", "rounded bristles"])
    uneven = draw.chance(0.4)
    pulley = draw.chance(0.5)
    weightless = draw.chance(0.5)
    same_before = draw.chance(0.5)
    count = draw.nominal.cable_count
    share = draw.rng.uniform(0.8, 1.2, count) if uneven else np.ones(count)
    numbers = {
        "breakaway": draw.uniform(1.15, 1.5) if onset == "breakaway" else 1.0,
        "pulley_rad": draw.uniform(0.3, 1.6) if pulley else 0.0,
        "presliding_m": _log_uniform(draw, 1e-5, 1e-4) if "bristles" in onset else 0.0,
        "actuator_share": draw.uniform(0.1, 0.4),
    }
    rounded = onset == "rounded bristles"
    first_state = {"weightless": weightless, "same_before": same_before}
    rough = sets("friction", coefficient=scaled(share), rounded=rounded, **numbers, **first_state)
    form = f"{onset}, {'uneven' if uneven else 'even'}, {'with' if pulley else 'no'} pulley"
    form += ", weightless at first" * weightless + ", the same before every pulley" * same_before
    return ArmChange(rough, form, details=numbers)


@LISTED.of_size("m", 0.0005, 0.05)
def contact_offset(draw: ArmDraw) -> ArmChange:
    """Loads that act nearer to the base or to the tip, on one segment or on all."""
    single = draw.chance(0.6)
    segment = draw.segment()
    shift = marked(segment if single else slice(None), draw.nominal.segment_count, draw.sign())
    moved = sets("body", contact_at_m=added(np.outer(shift, [1.0, 0.0, 0.0])))
    form = "one segment" if single else "all segments"
    toward_tip = float(shift[segment])
    return ArmChange(moved, form, places("segment", shift), {"toward_tip": toward_tip})


@LISTED.of_size("N m/rad", 0.05, 80.0)
def joint_elasticity(draw: ArmDraw) -> ArmChange:
    """Joints that spring back to straight, linearly or hardening a little."""
    chosen: Any = draw.segment() if draw.chance(0.6) else slice(None)
    hardening = float(draw.rng.choice([0.0, draw.rng.uniform(3.0, 15.0)]))
    share = _both_axes(chosen, draw)
    cubic = scaled(hardening * share)
    sprung = sets("body", spring_nm_rad=scaled(share), hardening_nm_rad3=cubic)
    form = "hardening" if hardening else "linear"
    return ArmChange(sprung, form, places("joint", share[:, 0]), {"hardening_rad2": hardening})


@LISTED.of_size("N m", 0.005, 2.0)
def joint_friction(draw: ArmDraw) -> ArmChange:
    """Dry friction in both axes of one, two or all joints: sharp, rounded or Stribeck's."""
    count = draw.nominal.segment_count
    share = _both_axes(slice(None) if draw.chance(0.3) else draw.some(count, 1, 2), draw)
    form = draw.one_of(["sharp", "rounded", "Stribeck"])
    rounded = form == "rounded"
    reach_rad = draw.uniform(5e-4, 3e-3) if rounded else 1e-4
    breakaway = draw.uniform(1.2, 1.8) if form == "Stribeck" else 1.0
    rough = sets(
        "friction",
        joint_nm=scaled(share),
        joint_rounded=rounded,
        joint_reach_rad=reach_rad,
        joint_breakaway=breakaway,
    )
    return ArmChange(rough, form, places("joint", share[:, 0]))


@LISTED.of_size("deg")
def load_cell(draw: ArmDraw) -> ArmChange:
    """A load cell that is turned against the base, of the wrong scale, or both."""
    form = draw.one_of(["axes", "scale", "axes and scale"])
    axis = np.array([1.0, 0.0, 0.0]) * draw.sign() + draw.rng.uniform(-0.4, 0.4, 3)
    sign = draw.sign()
    if form == "scale":
        scale = sets(load_turn=lambda old, size: old * (1.0 + size * sign))
        return ArmChange(scale, form, unit="1", least=0.003, most=0.5)
    per_deg = sign * draw.uniform(0.005, 0.02) if form == "axes and scale" else 0.0
    axis = axis / np.linalg.norm(axis)

    def turned_cell(old: Array, size: float) -> Array:
        return np.asarray((1.0 + size * per_deg) * rotation(size, axis).as_matrix() @ old)

    wrong = sets(load_turn=turned_cell)
    details = {"scale_per_deg": per_deg}
    return ArmChange(wrong, form, details=details, least=0.3, most=25.0)


@LISTED.of_size("kg", 0.005, 4.0)
def payload(draw: ArmDraw) -> ArmChange:
    """A mass on a segment's axis, anywhere along it."""
    segment = draw.segment()
    at_m = draw.uniform(0.0, float(draw.nominal.length_m[segment]))

    def loaded(arm: RealArm, size: float) -> RealArm:
        body = arm.body
        joint = np.append(body.mass_joint, body.driven[segment])
        mass_at_m = np.vstack([body.mass_at_m, [at_m, 0.0, 0.0]])
        mass = np.append(body.mass_kg, size)
        return replace(
            arm, body=replace(body, mass_kg=mass, mass_joint=joint, mass_at_m=mass_at_m)
        )

    return ArmChange(loaded, "point mass", (f"segment_{segment + 1}",), {"at_m": at_m})


@LISTED.of_size("N", 0.3, 30.0)
def pretension_error(draw: ArmDraw) -> ArmChange:
    """One to all cables tensioned to another value, all by the same or each by its own."""
    chosen = draw.cables(1, 4 if draw.chance(0.7) else draw.nominal.cable_count)
    alike = draw.chance(0.7)
    share = draw.weights(chosen, signed=True)
    if alike:
        share = np.where(share != 0.0, draw.sign(), 0.0)
    least = 0.1 * draw.nominal.pretension_n
    form = "all by the same" if alike else "each by its own"
    return ArmChange(
        sets("body", pretension_n=lambda old, size: np.maximum(old + size * share, least)),
        form,
        places("cable", share),
    )


@LISTED.of_size("deg", 0.1, 15.0)
def routing_geometry(draw: ArmDraw) -> ArmChange:
    """Holes on another radius or at another angle.

    Those of the cables that end on a segment, in every plate they pass; or those of all cables in
    the two plates that a segment carries.
    """
    segment = draw.segment()
    radius = draw.chance(0.5)
    carried = draw.chance(0.4)
    sign = draw.sign()
    before, after = np.zeros((2, draw.nominal.segment_count, draw.nominal.cable_count))
    if carried:
        after[segment] = sign
        before[segment + 1 : segment + 2] = sign
    else:
        segment_cables = np.arange(draw.nominal.cable_count) // draw.nominal.per_segment == segment
        before[:, segment_cables] = after[:, segment_cables] = sign
    of = "plates of the segment" if carried else "cables that end on the segment"
    where = (f"segment_{segment + 1}",)
    law = _further_out if radius else _turned_deg
    moved = sets(
        "body",
        before_m=lambda old, size: law(old, size, before),
        after_m=lambda old, size: law(old, size, after),
    )
    if radius:
        return ArmChange(moved, f"radius, {of}", where, unit="m", least=5e-5, most=0.012)
    return ArmChange(moved, f"angle, {of}", where)


def _turned_deg(points_m: Array, size: float, share: Array) -> Array:
    return turned(points_m, np.deg2rad(size * share))


def _further_out(points_m: Array, size: float, share: Array) -> Array:
    moved = points_m.copy()
    radius = np.linalg.norm(moved[..., 1:], axis=-1)
    moved[..., 1:] *= ((radius + size * share) / radius)[..., None]
    return moved


@LISTED.of_size("1", 0.0005, 0.3)
def sensor_crosstalk(draw: ArmDraw) -> ArmChange:
    """A share of one channel in its neighbours, or of every channel in its neighbours.

    The place is the channel whose signal leaks.
    """
    count = draw.nominal.cable_count
    single = draw.chance(0.6)
    chosen = int(draw.rng.integers(count))
    source = marked(chosen if single else slice(None), count)
    leak = (np.eye(count, k=1) + np.eye(count, k=-1)) * source
    leak = leak * float(draw.rng.choice([-1.0, 1.0], p=[0.2, 0.8]))
    form = "one channel into its neighbours" if single else "all channels into their neighbours"
    leaking = faulty("sensing", LEAKED, lambda size, signal, *_: signal + signal @ (size * leak).T)
    return ArmChange(leaking, form, places("cable", source))


@LISTED.of_size("N", 0.1, 40.0)
def sensor_drift(draw: ArmDraw) -> ArmChange:
    """Zeros that drift: steadily, slowly to and fro, at random, or while warming up."""
    chosen = draw.cables(1, 4)
    shape = draw.one_of(_SHAPES_OF_DRIFT)
    scale_s = draw.uniform(60.0, 400.0) if shape == "slow sine" else draw.uniform(20.0, 90.0)
    share = draw.weights(chosen, signed=True)
    phase_rad = draw.uniform(0.0, 2.0 * np.pi)
    seed = int(draw.rng.integers(2**31))

    def drifting(size: float, signal_n: Array, time_s: Array) -> Array:
        since = (time_s - time_s[0])[:, None]
        if shape == "linear":
            course = since / since[-1]
        elif shape == "slow sine":
            course = np.sin(2.0 * np.pi * since / scale_s + phase_rad)
        elif shape == "warm-up":
            course = 1.0 - np.exp(-since / scale_s)
        else:
            walk = np.random.default_rng(seed).standard_normal(signal_n.shape).cumsum(axis=0)
            course = (walk - walk[0]) / np.abs(walk - walk[0]).max(axis=0)
        return np.asarray(signal_n + course * (size * share))

    drift = faulty("sensing", ADDED, drifting)
    return ArmChange(drift, shape, places("cable", share), {"time_s": scale_s})


@LISTED.of_size("1", 0.001, 0.4)
def sensor_gain(draw: ArmDraw) -> ArmChange:
    """Wrong scale on one to four sensors."""
    share = draw.weights(draw.cables(1, 4), signed=True)
    wrong = faulty("sensing", SCALED, lambda size, signal, *_: signal * (1.0 + size * share))
    return ArmChange(wrong, "each by its own", places("cable", share))


@LISTED.of_size("s", 0.01, 8.0)
def sensor_lag(draw: ArmDraw) -> ArmChange:
    """All or some sensors that follow late, through one of three filters."""
    chosen: Any = slice(None) if draw.chance(0.4) else draw.cables(1, 4)
    late = marked(chosen, draw.nominal.cable_count)
    kind = draw.one_of(FILTERS)
    lagging = faulty(
        "sensing", LATE, lambda size, signal, time_s: lagged(signal, time_s, size * late, kind)
    )
    return ArmChange(lagging, kind, places("cable", late))


def lagged(signal: Array, time_s: Array, lag_s: Array, kind: str) -> Array:
    """Columns of (R, M) through a filter each, settled at the first value before.

    `lag_s` (M,) is the time constant, or half the window of an average.
    """
    from scipy.signal import lfilter

    steps = len(time_s) - 1
    fine_s = np.interp(np.arange(steps * _FINE + 1) / _FINE, np.arange(steps + 1), time_s)
    period_s = float(fine_s[1] - fine_s[0])
    late = signal.copy()
    for column in np.flatnonzero(lag_s):
        fine = np.interp(fine_s, time_s, signal[:, column])
        if kind == "moving average":
            fine = _averaged(fine, max(1.0, 2.0 * lag_s[column] / period_s))
        else:
            order = 1 if kind == "first order" else 2
            kept = np.exp(-period_s / (lag_s[column] / order))
            for _stage in range(order):
                fine, _ = lfilter([1.0 - kept], [1.0, -kept], fine, zi=[kept * fine[0]])
        late[:, column] = fine[::_FINE]
    return late


def _averaged(signal: Array, window: float) -> Array:
    """Mean over the last `window` samples, which need not be a whole number."""
    whole = int(np.ceil(window))
    total = np.concatenate([[0.0], np.cumsum(np.pad(signal, (whole, 0), mode="edge"))])
    ends = whole + np.arange(1, len(signal) + 1)
    starts = np.interp(ends - window, np.arange(len(total)), total)
    return (total[ends] - starts) / window


@LISTED.of_size("N", 0.1, 30.0)
def sensor_offset(draw: ArmDraw) -> ArmChange:
    """Zero errors on one to four sensors."""
    share = draw.weights(draw.cables(1, 4), signed=True)
    shifted = faulty("sensing", ADDED, lambda size, signal, *_: signal + size * share)
    return ArmChange(shifted, "each by its own", places("cable", share))


def _log_uniform(draw: ArmDraw, low: float, high: float) -> float:
    """A number between two, alike in its logarithm."""
    return float(np.exp(draw.rng.uniform(*np.log([low, high]))))


def _all_or_segment(draw: ArmDraw) -> tuple[Array, tuple[str, ...]]:
    """(M,) of 0 and 1 for all cables or those of a segment, and their place."""
    count = draw.nominal.cable_count
    per_segment = draw.nominal.per_segment
    if draw.chance(0.5):
        return np.ones(count), ()
    segment = draw.segment()
    segment_cables = np.arange(count) // per_segment == segment
    return segment_cables.astype(float), (f"segment_{segment + 1}",)


def _both_axes(chosen: Any, draw: ArmDraw) -> Array:
    """(N, 2) of 1 for both axes of the chosen joints."""
    return np.repeat(marked(chosen, draw.nominal.segment_count)[:, None], 2, axis=1)
