"""What `cablesense info` says of a machine file: its parts, and what sensors tell of contacts."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cablesense_base import Array

Description = dict[str, Any]

_ACROSS = np.array([0.6, 0.8])
"""Direction of the force across a link of which it is told how well it is known."""
_USUAL_SHARE = 0.2
"""That force by default, as a share of the largest."""

_LEAST_RANGE_M = 1e-6
"""A range of places that is a point has this deviation."""
_OF_RANGE = 0.8
"""Share of a range's deviation from which on a place counts as not told."""


def machine_description(path: str) -> Description:
    """Channels, joints, links and uncertain parameters of a machine, as plain values in SI units.

    Raises:
        MachineError: it cannot be used.
    """
    from cablesense_contact.machine.observation import Observer
    from cablesense_sim.machine.capacity import borne_n
    from cablesense_sim.machine.machine import open_machine
    from cablesense_sim.machine.simulated import SimulatedMachine

    machine = open_machine(path)
    observer = Observer(machine)
    parameters = observer.parameters
    nominal = SimulatedMachine(machine, parameters, 0.0 * parameters.prior_mean)
    command = observer.command_of(machine.reference)
    untouched = nominal.untouched(command)
    channels = machine.channels
    links = machine.links
    return {
        "kind": "machine",
        "file": path,
        "name": machine.name,
        "identity": machine.identity,
        "model": str(machine.source.model_path),
        "joints": machine.source.file.joints,
        "channels": [
            {
                "name": name,
                "unit": unit,
                "reads_untouched": float(value),
                "noise_std": float(noise),
                "step": float(step),
            }
            for name, unit, value, noise, step in zip(
                channels.names,
                channels.units,
                untouched.values,
                channels.noise_std,
                channels.step,
                strict=True,
            )
        ],
        "commands": list(machine.command_names),
        "reference_command": dict(
            zip(machine.command_names, np.round(command, 6).tolist(), strict=True)
        ),
        "coordinates": list(machine.coordinates.names),
        "links": [
            {
                "name": name,
                "touched_m": touched.tolist(),
                "radius_m": float(radius_m),
                "bears_n": float(bears_n),
            }
            for name, touched, radius_m, bears_n in zip(
                links.names,
                links.touched_m,
                links.radius_m,
                borne_n(nominal, command),
                strict=True,
            )
        ],
        "largest_n": machine.source.file.touch.largest_n,
        "parameters": {group.name: len(group.places) for group in parameters.groups},
    }


def weak_links(description: Description) -> str:
    """A warning, where tendons go slack before the largest force that the file expects."""
    largest_n = description["largest_n"]
    weak = [
        f"{link['name']} {link['bears_n']:.3g} N"
        for link in description["links"]
        if link["bears_n"] < largest_n
    ]
    if not weak:
        return ""
    return (
        f"A tendon goes slack before touch.largest_n ({largest_n:g} N) at the far end of: "
        f"{', '.join(weak)}. A sample with a slack tendon says less, or is refused: raise "
        "cables.pretension_n, or lower largest_n."
    )


def machine_observability(path: str, load_n: float | None = None) -> Description:
    """What one reading tells of a contact in the middle of each link, in the reference pose.

    `load_n` is the lateral force, by default a fifth of the largest that is expected.

    The deviations are those that no estimate can be below (Cramér-Rao), with the noise of the
    sensors alone, and with the tolerances of the machine file before any tare. The axial force is
    taken to be as large as friction lets it, the place within the range that the file states.

    Raises:
        MachineError: it cannot be used, or does not bear the load.
    """
    from cablesense_contact.machine.felt_directions import felt_across, is_planar
    from cablesense_contact.machine.observation import Observer
    from cablesense_sim.machine.machine import open_machine
    from cablesense_sim.machine.simulated import SimulatedMachine
    from cablesense_sim.machine.statics import LinkForce

    machine = open_machine(path)
    if load_n is None:
        load_n = _USUAL_SHARE * machine.source.file.touch.largest_n
    observer = Observer(machine)
    projections = felt_across(observer)
    parameters = observer.parameters
    exact = 0.0 * parameters.prior_mean
    nominal = SimulatedMachine(machine, parameters, exact)
    command = observer.command_of(machine.reference)
    untouched = nominal.untouched(command)
    count = len(machine.coordinates)
    rows = []
    for link, name in enumerate(machine.links.names):
        first_m, last_m = machine.links.touched_m[link].tolist()
        place_m = 0.5 * (first_m + last_m)
        # the place is one of the touched range, equally probable
        range_std_m = (last_m - first_m) / np.sqrt(12.0) + _LEAST_RANGE_M
        felt = projections[link]
        across = felt @ _ACROSS
        across_n = load_n * across / np.linalg.norm(across)
        force = LinkForce(link, np.array([place_m, 0.0, 0.0]), np.append(0.0, across_n))
        reading = nominal.touched(command, [force], untouched).values
        in_plane = bool(is_planar(projections)[link])
        row: Description = {
            "link": name,
            "place_m": place_m,
            "felt_along": _in_body_axes(machine.links.axes[link], felt) if in_plane else None,
        }
        axial_n = (machine.source.file.touch.friction or 1.0) * load_n
        for key, covariance in (
            ("", np.zeros((len(exact), len(exact)))),
            ("built_", np.diag(parameters.prior_std**2)),
        ):
            seen = observer.observe(reading, command, exact, covariance, np.zeros((count, count)))
            levers = seen.levers[link]
            by_force = levers[:3] + place_m * levers[3:]
            by_place = force.force_n @ levers[3:]
            slope = seen.by_torque @ np.concatenate([by_force, by_place[None]]).T
            information = slope.T @ seen.information @ slope
            bound = _bound(information, felt, load_n, axial_n, range_std_m)
            row[f"{key}force_n"] = bound.force_n
            row[f"{key}place_mm"] = bound.place_mm
        rows.append(row)
    return {"kind": "observability", "file": path, "load_n": load_n, "links": rows}


def notes_on_links(seen: Description) -> str:
    """Notes on links whose force is known in a plane, or not at all; empty without such links."""
    notes = []
    planar = [
        f"{row['link']} ({', '.join(f'{part:g}' for part in row['felt_along'])})"
        for row in seen["links"]
        if row["felt_along"] is not None
    ]
    if planar:
        notes.append(
            f"On {', '.join(planar)} readings depend on forces in one plane alone, that of the "
            "link's axis and of this direction across it, in the axes of its body: the force in "
            "it is stated, and what acts across it is not felt."
        )
    unseen = [row["link"] for row in seen["links"] if row["force_n"] is None]
    if unseen:
        notes.append(
            f"A dash: one reading does not tell this apart from the rest. On {', '.join(unseen)} "
            "a push is known by its moments on the joints alone (state `moment`), as fewer of "
            "them are read than a force and its place have numbers. If a link is touched at one "
            "place only, list that place under touch.links: then its force is known."
        )
    return " ".join(notes)


def _in_body_axes(axes: Array, felt: Array) -> list[float]:
    """(3,) the direction across a link that is felt, by a projection (2, 2), in its body's axes.

    `axes` (3, 3) are those of the link. The largest part of the direction is positive.
    """
    strongest = int(np.diagonal(felt).argmax())
    across = felt[:, strongest] / np.linalg.norm(felt[:, strongest])
    direction = axes[:, 1:] @ across
    direction *= np.sign(direction[np.abs(direction).argmax()])
    return [float(part) for part in np.round(direction, 3) + 0.0]


class _Bound(NamedTuple):
    """Deviations of lateral force and place that no estimate is below.

    None where a reading tells nothing of them: of the force no more than its size, of the place no
    more than its range.
    """

    force_n: float | None
    place_mm: float | None


def _bound(
    information: Array, felt: Array, load_n: float, axial_n: float, range_std_m: float
) -> _Bound:
    """By the information (4, 4) of a reading on force and place.

    Of the force across the link the part by the projection (2, 2) is felt.
    """
    known = np.diag([axial_n**-2, 1e-6 * load_n**-2, 1e-6 * load_n**-2, range_std_m**-2])
    covariance = np.linalg.inv(information + known)
    force_n = float(np.sqrt(np.trace(felt @ covariance[1:3, 1:3] @ felt)))
    place_m = float(np.sqrt(covariance[3, 3]))
    return _Bound(
        force_n=round(force_n, 4) if force_n < load_n else None,
        place_mm=round(1e3 * place_m, 3) if place_m < _OF_RANGE * range_std_m else None,
    )
