"""The effects that verdicts have names for, drawn in the forms that physics offers.

Lost motion in actuators.

Friction, creep, stiffness and pretension of cables.

Friction and springs of joints.

Weights and loads that are not as believed.

Guide holes that are elsewhere than drawn.

Tension sensors that do not say what is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np

from cablesense_gap.plant.arm import RealArm, turned
from cablesense_gap.plant.body import Nominal
from cablesense_gap.plant.changes import Change, Draw, places, some, weights
from cablesense_gap.plant.rubbing import Creep, Onset
from cablesense_gap.plant.sensing import Course, Filter, Wander


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


def friction(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Dry friction in both axes of one, two or all joints: sharp, rounded or Stribeck's."""
    chosen = _some_joints(rng, nominal)
    form = str(rng.choice(["sharp", "rounded", "Stribeck"]))
    rounded = form == "rounded"
    return Change(
        effect="joint_friction",
        form=form,
        unit="N m",
        least=0.005,
        most=2.0,
        apply=partial(
            _rubbing_joints,
            joints=chosen,
            onset=Onset.ROUNDED if rounded else Onset.SHARP,
            reach_rad=float(rng.uniform(5e-4, 3e-3)) if rounded else 1e-4,
            breakaway=float(rng.uniform(1.2, 1.8)) if form == "Stribeck" else 1.0,
        ),
        where=places("joint", chosen, nominal.segment_count),
    )


def _rubbing_joints(
    arm: RealArm,
    size: float,
    joints: list[int],
    onset: Onset,
    reach_rad: float,
    breakaway: float,
) -> RealArm:
    torque = np.zeros((arm.body.joint_count, 2))
    torque[arm.body.driven[joints]] = size
    rubbing = replace(
        arm.rubbing,
        joint_nm=torque,
        joint_onset=onset,
        joint_reach_rad=reach_rad,
        breakaway=breakaway,
    )
    return replace(arm, rubbing=rubbing)


def elasticity(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Joints that spring back to straight, linearly or hardening a little."""
    one = rng.random() < 0.6
    count = nominal.segment_count
    chosen = [int(rng.integers(count))] if one else list(range(count))
    hardening = float(rng.choice([0.0, rng.uniform(3.0, 15.0)]))
    return Change(
        effect="joint_elasticity",
        form="hardening" if hardening else "linear",
        unit="N m/rad",
        least=0.05,
        most=80.0,
        apply=partial(_sprung, joints=chosen, hardening_rad2=hardening),
        where=places("joint", chosen, count),
        details={"hardening_rad2": hardening},
    )


def _sprung(arm: RealArm, size: float, joints: list[int], hardening_rad2: float) -> RealArm:
    spring = np.zeros((arm.body.joint_count, 2))
    spring[arm.body.driven[joints]] = size
    body = replace(arm.body, spring_nm_rad=spring, hardening_nm_rad3=hardening_rad2 * spring)
    return replace(arm, body=body)


def _some_joints(rng: np.random.Generator, nominal: Nominal) -> list[int]:
    count = nominal.segment_count
    return list(range(count)) if rng.random() < 0.3 else some(rng, count, 1, 2)


def payload(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A mass on a segment's axis, anywhere along it."""
    segment = int(rng.integers(nominal.segment_count))
    at_m = float(rng.uniform(0.0, nominal.length_m))
    return Change(
        effect="payload",
        form="point mass",
        unit="kg",
        least=0.005,
        most=4.0,
        apply=partial(_loaded, segment=segment, at_m=at_m),
        where=(f"segment_{segment + 1}",),
        details={"at_m": at_m},
    )


def _loaded(arm: RealArm, size: float, segment: int, at_m: float) -> RealArm:
    body = arm.body
    return replace(
        arm,
        body=replace(
            body,
            mass_kg=np.append(body.mass_kg, size),
            mass_joint=np.append(body.mass_joint, body.driven[segment]),
            mass_at_m=np.vstack([body.mass_at_m, [at_m, 0.0, 0.0]]),
        ),
    )


def base_tilt(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A base that is not level: rolled, pitched or both; loads stay in base axes."""
    form = str(rng.choice(["roll", "pitch", "roll and pitch"]))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    axis = {"roll": (1.0, 0.0), "pitch": (0.0, 1.0)}.get(form, (np.cos(angle), np.sin(angle)))
    sign = float(rng.choice([-1.0, 1.0]))
    return Change(
        effect="base_tilt",
        form=form,
        unit="deg",
        least=0.1,
        most=30.0,
        apply=partial(_tilted, axis=(sign * float(axis[0]), sign * float(axis[1]))),
        details={"about_x": sign * float(axis[0]), "about_y": sign * float(axis[1])},
    )


def _tilted(arm: RealArm, size: float, axis: tuple[float, float]) -> RealArm:
    from scipy.spatial.transform import Rotation

    base = Rotation.from_rotvec(np.deg2rad(size) * np.array([*axis, 0.0]))
    gravity = base.inv().apply(arm.body.gravity_m_s2)
    return replace(arm, body=replace(arm.body, gravity_m_s2=gravity))


def contact_offset(rng: np.random.Generator, nominal: Nominal) -> Change:
    """Loads that act nearer to the base or to the tip, on one segment or on all."""
    count = nominal.segment_count
    one = bool(rng.random() < 0.6)
    segment = int(rng.integers(count))
    shift = np.zeros(count)
    shift[segment if one else slice(None)] = rng.choice([-1.0, 1.0])
    return Change(
        effect="contact_offset",
        form="one segment" if one else "all segments",
        unit="m",
        least=0.0005,
        most=0.05,
        apply=partial(_shifted, shift=shift),
        where=(f"segment_{segment + 1}",) if one else (),
        details={"toward_tip": float(shift[segment])},
    )


def _shifted(arm: RealArm, size: float, shift: np.ndarray) -> RealArm:
    contact = arm.body.contact_at_m.copy()
    contact[:, 0] += size * shift
    return replace(arm, body=replace(arm.body, contact_at_m=contact))


def routing_geometry(rng: np.random.Generator, nominal: Nominal) -> Change:
    """A segment's holes on another radius or at another angle, by either reading of "a segment's".

    Those of the cables that end on it, in every plate they pass; or those of all cables in the
    two plates that the segment carries.
    """
    segment = int(rng.integers(nominal.segment_count))
    radius = bool(rng.random() < 0.5)
    carried = bool(rng.random() < 0.4)
    of = "plates of the segment" if carried else "cables that end on the segment"
    return Change(
        effect="routing_geometry",
        form=f"{'radius' if radius else 'angle'}, {of}",
        unit="m" if radius else "deg",
        least=5e-5 if radius else 0.1,
        most=0.012 if radius else 15.0,
        apply=partial(
            _rerouted,
            segment=segment,
            radius=radius,
            carried=carried,
            sign=float(rng.choice([-1.0, 1.0])),
        ),
        where=(f"segment_{segment + 1}",),
    )


def _rerouted(
    arm: RealArm, size: float, segment: int, radius: bool, carried: bool, sign: float
) -> RealArm:
    body = arm.body
    before, after = np.zeros(body.before_m.shape[:2]), np.zeros(body.after_m.shape[:2])
    if carried:
        after[segment] = sign
        before[segment + 1 : segment + 2] = sign
    else:
        own = np.arange(body.cable_count) // arm.nominal.per_segment == segment
        before[:, own] = after[:, own] = sign
    move = _further_out if radius else _turned_deg
    moved = replace(
        body,
        before_m=move(body.before_m, size * before),
        after_m=move(body.after_m, size * after),
    )
    return replace(arm, body=moved)


def _turned_deg(points_m: np.ndarray, by_deg: np.ndarray) -> np.ndarray:
    return turned(points_m, np.deg2rad(by_deg))


def _further_out(points_m: np.ndarray, by_m: np.ndarray) -> np.ndarray:
    moved = points_m.copy()
    radius = np.linalg.norm(moved[..., 1:], axis=-1)
    moved[..., 1:] *= ((radius + by_m) / radius)[..., None]
    return moved


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


LISTED: Mapping[str, Draw] = MappingProxyType(
    {
        "actuator_backlash": backlash,
        "base_tilt": base_tilt,
        "cable_creep": creep,
        "cable_stiffness": stiffness,
        "capstan_friction": capstan_friction,
        "contact_offset": contact_offset,
        "joint_elasticity": elasticity,
        "joint_friction": friction,
        "payload": payload,
        "pretension_error": pretension_error,
        "routing_geometry": routing_geometry,
        "sensor_crosstalk": crosstalk,
        "sensor_drift": drift,
        "sensor_gain": gain,
        "sensor_lag": lag,
        "sensor_offset": offset,
    }
)
