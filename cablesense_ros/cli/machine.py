"""`cablesense machine`: a machine file to start from, guessed from an MJCF or a URDF."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cablesense_base.files import output_file, write_atomically
from cablesense_ros.cli.options import ForceOption


def machine(
    model: Annotated[Path, typer.Argument(help="The MJCF or URDF of a cable-driven machine.")],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The machine file to write, .yaml, in the folder of the model.",
            show_default="beside the model",
        ),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Write a machine file to start from: which forces of a model are read, where it is touched.

    It is guessed from the model's tendons, actuators and shapes. Correct it, then go on with
    [bold]cablesense export --arm FILE[/bold]. Any machine of hinges and slides will do: a finger,
    a hand, an arm with cables, a robot with joint torques.

    Example: cablesense machine finger.xml
    """
    from cablesense_sim.machine.description import MachineError
    from cablesense_sim.machine.guess import guessed_machine_file
    from cablesense_sim.machine.machine import open_machine

    path = out or model.with_suffix(".yaml")
    output_file(path, force=force, inputs=(model,))
    write_atomically(path, guessed_machine_file(model).encode(), MachineError)
    try:
        opened = open_machine(path)
    except MachineError as error:
        raise MachineError(
            f"{error}. {path} has the guess as far as it goes: correct it, or mend the model and "
            "guess again with --force"
        ) from error
    links = len(opened.links.names)
    channels = len(opened.channels.names)
    joints = len(opened.coordinates)
    print(f"{opened.identity}: {channels} channels, {joints} joints, {links} links to be touched")
    print(f"{path}: a guess; correct it, look at it, then make its estimator:")
    print(f"  cablesense info {path}")
    print(f"  cablesense export --arm {path} --out {path.with_suffix('.onnx')}")
