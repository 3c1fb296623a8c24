"""The bound on estimates of a contact anywhere on an arm, as a table and as a picture."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_base.files import write_atomically
from cablesense_sim.arm import Arm, ArmFileError, find_arm, load_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.contact_location import AXIAL_STD_N, contact_information, reach_m
from cablesense_sim.replay import difference_variance_n2

TARE_SAMPLES = 50
"""The node averages as many for a tare by default."""

_POSES = 100
_DETERMINED = 0.5
"""A number is called undetermined if the bound exceeds this share of its prior's deviation."""
_PLACES = 12


def describe_observability(name: str, force_n: float, bend_deg: float) -> dict[str, Any]:
    """Medians of the bound by segment, of the straight arm and of bent ones.

    Poses are random, each joint within `bend_deg`. A number that the tensions do not determine
    is None.

    Raises:
        CableSenseError: no such arm file, or an arm that has no equilibrium under such a contact.
    """
    arm = load_arm(find_arm(name))
    low, high = reach_m(mechanism_of(arm)).T
    known = {
        "place_mm": _DETERMINED * 1e3 * (high - low) / np.sqrt(12.0),
        "lateral_n": np.full(arm.segment_count, _DETERMINED * force_n),
        "axial_n": np.full(arm.segment_count, _DETERMINED * AXIAL_STD_N),
    }
    found: dict[str, Any] = {}
    for pose, bend in (("straight", 0.0), (f"joints within {bend_deg:g} degrees", bend_deg)):
        found[pose] = {}
        for n in range(arm.segment_count):
            rng = np.random.default_rng(n)
            place_m = rng.uniform(low[n], high[n], _POSES)
            command_rad = _commands_rad(arm, bend, rng)
            bound = _bound(arm, n + 1, place_m, force_n * _directions(rng), command_rad)
            median = {key: float(f"{np.median(values):.3g}") for key, values in bound.items()}
            found[pose][f"segment {n + 1}"] = {
                key: None if key in known and value > known[key][n] else value
                for key, value in median.items()
            }
    return {
        "arm": arm.identity,
        "contact_n": force_n,
        "poses, places and directions": _POSES,
        **found,
    }


def _commands_rad(arm: Arm, bend_deg: float, rng: np.random.Generator) -> Array:
    bend = np.deg2rad(bend_deg)
    return rng.uniform(-bend, bend, (_POSES, arm.joint_count))


def _directions(rng: np.random.Generator) -> Array:
    angle = rng.uniform(0.0, 2.0 * np.pi, _POSES)
    return np.stack([np.zeros(_POSES), np.sin(angle), np.cos(angle)], axis=1)


def _bound(
    arm: Arm, segment: int, place_m: Array, force_n: Array, command_rad: Array
) -> dict[str, Array]:
    """Standard deviations (B,) for lateral forces (B, 3) at places (B,) in poses (B, 2N)."""
    count, mechanism = len(place_m), mechanism_of(arm)
    size_n = np.linalg.norm(force_n, axis=1, keepdims=True)
    along = force_n / size_n
    variance_n2 = difference_variance_n2(arm.sensors, TARE_SAMPLES)
    information = contact_information(
        mechanism, command_rad, np.full(count, segment), place_m, force_n, variance_n2
    )
    low, high = reach_m(mechanism)[segment - 1]
    prior = np.diag([AXIAL_STD_N**-2, 0.0, 0.0, 12.0 / (high - low) ** 2])
    covariance = np.linalg.inv(information + prior)

    def deviation(gradient: Array) -> Array:
        return np.sqrt(np.einsum("bi,bij,bj->b", gradient, covariance, gradient))

    nothing, one = np.zeros((count, 1)), np.ones((count, 1))
    axial = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return {
        "place_mm": 1e3 * deviation(np.hstack([nothing, nothing, nothing, one])),
        "lateral_n": deviation(np.hstack([along, nothing])),
        "axial_n": deviation(axial),
        "moment_n_m": deviation(np.hstack([place_m[:, None] * along, size_n])),
    }


def write_observability_picture(path: Path, name: str, force_n: float, bend_deg: float) -> None:
    """Draw the bound along the arm, as PNG or SVG by the file's ending.

    Raises:
        ArmFileError: the file cannot be written.
        CableSenseError: as `describe_observability`.
    """
    from matplotlib.figure import Figure

    arm = load_arm(find_arm(name))
    reach = reach_m(mechanism_of(arm))
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    panels = figure.subplots(1, 3, sharex=True)
    titles = {
        "place_mm": "place, mm",
        "lateral_n": "lateral force, N",
        "axial_n": "axial force, N",
    }
    for bend, style in ((0.0, "--"), (bend_deg, "-")):
        for n, (low, high) in enumerate(reach):
            rng = np.random.default_rng(n)
            command_rad, force = _commands_rad(arm, bend, rng), force_n * _directions(rng)
            places_m = np.linspace(low, high, _PLACES)
            bounds = [
                _bound(arm, n + 1, np.full(_POSES, place_m), force, command_rad)
                for place_m in places_m
            ]
            for axes, key in zip(panels, titles, strict=True):
                median = [np.median(bound[key]) for bound in bounds]
                label = f"joints within {bend:g}°" if n == 0 else None
                at = n + 1 + places_m / high
                axes.semilogy(at, median, style, color=f"C{int(bend > 0.0)}", label=label)
    for axes, title in zip(panels, titles.values(), strict=True):
        axes.set(title=title, xlabel="along the arm, segments", xticks=range(1, len(reach) + 2))
        axes.grid(which="both", alpha=0.2)
    panels[0].legend()
    figure.suptitle(
        f"{arm.name}: standard deviations that one sample leaves of a contact of {force_n:g} N"
    )
    drawn = io.BytesIO()
    figure.savefig(drawn, format=path.suffix.removeprefix(".") or "png", dpi=110)
    write_atomically(path, drawn.getvalue(), ArmFileError)
