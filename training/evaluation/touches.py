"""Contacts anywhere on arms as a workshop builds them, and what their sensors read of them.

An arm differs from its file as its tolerances allow (`cablesense_sim.built_arm`): the equilibrium
solver has these errors as they are, where the law has their derivatives. Where the file lists
friction, each sample comes at the end of a history.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.calibration import Unloaded
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.built_arm import BuiltArm, as_described
from cablesense_sim.effects.registry import (
    EffectEntry,
    actuations,
    amended,
    joint_zeros_rad,
    transmissions,
)
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.replay import read_tensions_n
from cablesense_sim.touch import TouchedPlaces, touched_places
from cablesense_training.data.dataset import contact_forces_n
from cablesense_training.data.generation import TARED, LoadHistory, sensed_along_n
from cablesense_training.data.protocols import (
    CHUNK_SAMPLES,
    AnywhereContact,
    Cases,
    chunk_sizes,
    unit_points,
)

COMMISSIONED_POSES = 25
"""Unloaded poses by which an arm is calibrated: straight, then at random."""
TARE_SAMPLES = 50
"""Readings of each of them."""

_REST_S = 0.5
"""From one pose of a commissioning to the next."""


class Touches(NamedTuple):
    """What acts on B samples of an arm with N segments; zeros where nothing touches.

    Attributes:
        command_rad: (B, 2N).
        contacts: (B, N) whether a segment is touched.
        place_m: (B, N) distance of each contact from its joint centre.
        force_n: (B, N, 3) along the axes that the segments have at the command.
        line_m: (B, N) where the force's line of action meets the axis, from the joint centre:
            touched at a radius, an axial force moves it away from the place.
    """

    command_rad: Array
    contacts: NDArray[np.bool_]
    place_m: Array
    force_n: Array
    line_m: Array

    def select(self, rows: NDArray[np.bool_] | slice) -> Touches:
        """Some of the samples."""
        return Touches._make(part[rows] for part in self)


def drawn_touches(arm: Arm, protocol: AnywhereContact, seed: int) -> Touches:
    """The samples of a protocol, each contact at a radius that is uniform up to the surface's."""
    places = touched_places(arm)
    parts = []
    for chunk, rows in enumerate(chunk_sizes(protocol.samples)):
        points = unit_points(protocol.dimensions(arm.segment_count), seed, chunk)[:rows]
        cases = protocol.cases(places.touched_m, points)
        share = np.random.default_rng([seed, chunk]).uniform(size=(CHUNK_SAMPLES, 1))[:rows]
        parts.append(_touches(cases, places, share))
    return Touches._make(np.concatenate(column) for column in zip(*parts, strict=True))


def _touches(cases: Cases, places: TouchedPlaces, share: Array) -> Touches:
    """The contacts of a protocol at these shares (B, 1) of the surface's radius."""
    theta = np.deg2rad(cases.angles_deg)
    lateral_n = cases.magnitudes_n
    across = lateral_n[..., None] * np.stack([np.sin(theta), np.cos(theta)], axis=-1)
    ratio = np.divide(cases.along_n, lateral_n, out=np.zeros_like(lateral_n), where=lateral_n > 0)
    return Touches(
        command_rad=cases.command_rad,
        contacts=cases.contacts,
        place_m=cases.places_m,
        force_n=np.concatenate([cases.along_n[..., None], across], axis=-1),
        line_m=cases.places_m + share * places.radius_m * ratio,
    )


def unloaded_readings(
    arm: Arm, built: BuiltArm, reach_rad: float, rng: np.random.Generator
) -> list[Unloaded]:
    """Means of readings in `COMMISSIONED_POSES`, one pose after another.

    Raises:
        EquilibriumError: the arm finds no rest in one of them.
    """
    commands = rng.uniform(-reach_rad, reach_rad, (COMMISSIONED_POSES, arm.joint_count))
    commands[0] = 0.0
    time_s: Array = _REST_S * np.arange(COMMISSIONED_POSES, dtype=float)
    nothing = np.zeros((COMMISSIONED_POSES, 1, arm.segment_count, 3))
    tensions = tensions_along_n(arm, built, time_s, commands[:, None], nothing)
    if not np.isfinite(tensions).all():
        raise EquilibriumError("the unloaded arm finds no rest in a pose", [0])
    several = np.repeat(tensions, TARE_SAMPLES, axis=1)
    readings = _read_n(arm, built, time_s, several, rng).mean(axis=1)
    return [
        Unloaded(reading, command, TARE_SAMPLES)
        for reading, command in zip(readings, commands, strict=True)
    ]


def touched_readings_n(
    arm: Arm, built: BuiltArm, touches: Touches, rng: np.random.Generator
) -> Array:
    """Readings (K, B, M) of an arm from its tare in each pose on, until the contact is answered.

    There are two of them where nothing depends on the past, NaN of what the arm does not bear.
    """
    forces = _forces_n(arm, touches)
    count = len(forces)
    rubs = bool(transmissions([built.entries]))
    history = LoadHistory.drawn(count, rng) if rubs else LoadHistory.plain(count)
    commands = history.commands_rad(touches.command_rad)
    loads = history.loads_n(forces)
    time_s = history.time_s
    if not rubs:
        ends = [TARED, len(time_s) - 1]
        commands = commands[ends]
        loads = loads[ends]
        time_s = time_s[ends]
    tensions = tensions_along_n(arm, built, time_s, commands, loads, touches.line_m)
    readings = _read_n(arm, built, time_s, tensions, rng)
    return readings[TARED:] if rubs else readings


def settled_readings_n(arm: Arm, touches: Touches, rng: np.random.Generator) -> Array:
    """Readings (B, M) of exactly the arm of a file at rest under each touch; NaN without a rest.

    An equilibrium has no memory: friction, creep and backlash are left out, and sensors with a
    memory are read as they settle.
    """
    described = as_described(arm)
    entries = [entry for entry in described.entries if not _remembers(entry)]
    at_rest = replace(described, entries=entries)
    now = np.zeros(1)
    commands = touches.command_rad[None]
    loads = _forces_n(arm, touches)[None]
    tensions = tensions_along_n(arm, at_rest, now, commands, loads, touches.line_m)
    return np.asarray(_read_n(arm, at_rest, now, tensions, rng)[0])


def _remembers(entry: EffectEntry) -> bool:
    """Whether what an effect does to tensions depends on what came before."""
    return bool(transmissions([[entry]])) or bool(actuations([[entry]]))


def _forces_n(arm: Arm, touches: Touches) -> Array:
    """(B, N, 3) the touches' forces, in base axes."""
    across = touches.force_n[..., 1:]
    return contact_forces_n(
        mechanism_of(arm),
        touches.command_rad,
        np.rad2deg(np.arctan2(across[..., 0], across[..., 1])),
        np.hypot(across[..., 0], across[..., 1]),
        touches.force_n[..., 0],
    )


def _read_n(
    arm: Arm, built: BuiltArm, time_s: Array, tensions_n: Array, rng: np.random.Generator
) -> Array:
    """Readings (R, B, M) of tensions (R, B, M) at times (R,): gains, zeros, noise and step."""
    read = built.read(tensions_n).swapaxes(0, 1)
    sensed = sensed_along_n(built.entries, time_s, read).swapaxes(0, 1)
    return read_tensions_n(sensed, arm.sensors, rng)


def tensions_along_n(
    arm: Arm,
    built: BuiltArm,
    time_s: Array,
    commands_rad: Array,
    loads_n: Array,
    places_m: Array | None = None,
) -> Array:
    """Tensions (R, B, M) of an arm in B courses from rest to rest, at times (R,); NaN without one.

    Commands are (R, B, 2N), loads (R, B, N, 3) at `places_m` (B, N) on the axes.
    """
    entries = [built.entries] * commands_rad.shape[1]
    listed_rad = joint_zeros_rad([built.entries], arm.segment_count)
    zeros_rad = built.joint_zeros_rad if listed_rad is None else built.joint_zeros_rad + listed_rad
    held = held_lengths_m(mechanism_of(arm), commands_rad + zeros_rad)
    for actuation in actuations(entries):
        held = actuation.along(time_s, held.swapaxes(0, 1)).swapaxes(0, 1)
    mechanism = amended(built.mechanism, built.entries)
    if transmissions(entries):
        from cablesense_sim.quasi_static import QuasiStaticArm  # compiled: others need not wait

        walk = QuasiStaticArm([mechanism] * len(entries), entries, some_may_fail=True)
        rests = zip(time_s, held, loads_n, strict=True)
        return np.stack([walk.step(*rest, places_m) for rest in rests])
    rests = zip(commands_rad, loads_n, held, strict=True)
    return np.stack([_at_rest_n(mechanism, *rest, places_m) for rest in rests])


def _at_rest_n(
    mechanism: Mechanism, command_rad: Array, loads_n: Array, held_m: Array, places_m: Array | None
) -> Array:
    """Tensions (B, M) of an arm without memory; NaN without a rest."""
    tensions = np.full_like(held_m, np.nan)
    rows = np.arange(len(held_m))
    while rows.size:
        touched = mechanism
        if places_m is not None:
            touched = replace(mechanism, contact_m=places_m[rows])
        try:
            rest = solve_equilibrium(
                touched, command_rad[rows], loads_n[rows], held_m=held_m[rows]
            )
        except EquilibriumError as error:
            if not error.failed.size:
                raise
            rows = np.delete(rows, error.failed)
        else:
            tensions[rows] = rest.tensions_n
            break
    return tensions
