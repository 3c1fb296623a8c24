"""What `cablesense info` says of a machine file: its parts, and what sensors tell of contacts."""

from __future__ import annotations

from typing import Any

import numpy as np

Description = dict[str, Any]


def machine_description(path: str) -> Description:
    """Channels, joints, links and uncertain parameters of a machine, as plain values in SI units.

    Raises:
        MachineError: it cannot be used.
    """
    from cablesense_contact.machine.observation import Observer
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
        "coordinates": list(machine.coordinates.names),
        "links": [
            {"name": name, "touched_m": touched.tolist(), "radius_m": float(radius_m)}
            for name, touched, radius_m in zip(
                links.names, links.touched_m, links.radius_m, strict=True
            )
        ],
        "parameters": {group.name: len(group.places) for group in parameters.groups},
    }


def machine_observability(path: str, load_n: float) -> Description:
    """What one reading tells of a contact in the middle of each link, in the reference pose.

    The deviations are those that no estimate can be below (Cramér-Rao), with the noise of the
    sensors alone, and with the tolerances of the machine file before any tare. The axial force is
    taken to be as large as friction lets it.

    Raises:
        MachineError: it cannot be used, or does not bear the load.
    """
    from cablesense_contact.machine.observation import Observer
    from cablesense_sim.machine.machine import open_machine
    from cablesense_sim.machine.simulated import SimulatedMachine
    from cablesense_sim.machine.statics import LinkForce

    machine = open_machine(path)
    observer = Observer(machine)
    parameters = observer.parameters
    exact = 0.0 * parameters.prior_mean
    nominal = SimulatedMachine(machine, parameters, exact)
    command = observer.command_of(machine.reference)
    untouched = nominal.untouched(command)
    count = len(machine.coordinates)
    rows = []
    for link, name in enumerate(machine.links.names):
        place_m = float(machine.links.touched_m[link].mean())
        force = LinkForce(link, np.array([place_m, 0.0, 0.0]), load_n * np.array([0, 0.6, 0.8]))
        reading = nominal.touched(command, [force], untouched).values
        row: Description = {"link": name, "place_m": place_m}
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
            force_n, place_mm = _deviations(information, load_n, axial_n)
            row[f"{key}force_n"] = force_n
            row[f"{key}place_mm"] = place_mm
        rows.append(row)
    return {"kind": "observability", "file": path, "load_n": load_n, "links": rows}


def _deviations(
    information: Any, load_n: float, axial_n: float
) -> tuple[float | None, float | None]:
    """Deviations of lateral force, N, and place, mm, by the information on (f, place).

    None where a reading tells nothing of them.
    """
    known = np.diag([axial_n**-2, 1e-6 * load_n**-2, 1e-6 * load_n**-2, 1e-4])
    covariance = np.linalg.inv(information + known)
    force_n = float(np.sqrt(covariance[1, 1] + covariance[2, 2]))
    place_m = float(np.sqrt(covariance[3, 3]))
    return (
        round(force_n, 4) if force_n < 100.0 * load_n else None,
        round(1e3 * place_m, 3) if place_m < 1.0 else None,
    )
