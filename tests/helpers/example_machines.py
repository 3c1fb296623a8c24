"""The example machines, small ones from text, and commands near their reference poses."""

from functools import cache
from pathlib import Path
from textwrap import dedent

import numpy as np

from cablesense_base import Array
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.machine import Machine, open_machine

MACHINES = Path(__file__).parents[2] / "config" / "machines"


@cache
def example_machine(name: str) -> Machine:
    """One of `config/machines`."""
    return open_machine(MACHINES / f"{name}.yaml")


def written_machine(folder: Path, model: str, file: str) -> Machine:
    """A machine of the text of its MJCF and of its machine file, without name and model."""
    (folder / "machine.xml").write_text(dedent(model))
    head = "name: machine\nmodel: machine.xml\n"
    (folder / "machine.yaml").write_text(head + dedent(file))
    return open_machine(folder / "machine.yaml")


def bent_command(machine: Machine, seed: int, reach_deg: float = 8.0) -> Array:
    """A command that holds a machine near a pose within some degrees of its reference."""
    coordinates = machine.coordinates
    rng = np.random.default_rng(seed)
    away = np.deg2rad(rng.uniform(-reach_deg, reach_deg, len(coordinates)))
    pose = machine.reference + np.where(coordinates.is_hinge, away, 0.0)
    return Holding(machine).command_of(pose)


def machine_with_friction(name: str, coefficient: float, folder: Path) -> Machine:
    """An example machine whose file, written to a folder, states a coefficient of friction."""
    file = example_machine(name).source.file
    cables = file.cables.model_copy(update={"friction_coefficient": coefficient})
    changed = file.model_copy(update={"cables": cables, "model": str(MACHINES / file.model)})
    path = folder / f"{name}.yaml"
    path.write_text(changed.model_dump_json())
    return open_machine(path)
