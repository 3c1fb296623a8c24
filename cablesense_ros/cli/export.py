"""`cablesense export`: the estimator of an arm as a model file, without training."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from cablesense_base.files import output_file
from cablesense_ros.cli.options import ForceOption, JsonOption, print_result
from cablesense_ros.cli.train import ArmOption, command_line


def export(
    out: Annotated[Path, typer.Option(help="The model file to write, .onnx.")],
    arm: ArmOption = "cdsm",
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Write the estimator of an arm as one ONNX file, in some seconds.

    It takes readings, commands and a calibration, and answers with the place and force of a
    contact anywhere on the arm, and with its rivals. Nothing is trained: it follows from the arm
    file. The model file contains the arm and this command.

    In place of an arm file --arm takes a machine file, beside an MJCF or a URDF of any other
    cable-driven machine (`cablesense machine`).

    Example: cablesense export --arm my_arm.yaml --out my_arm.onnx
    """
    from cablesense_sim.machine.description import is_machine_file

    started = time.perf_counter()
    command = command_line("export", {"arm": arm, "out": out})
    if is_machine_file(arm):
        content = _exported_machine(arm, out, command, force=force)
    else:
        content = _exported_arm(arm, out, command, force=force)
    content["seconds"] = time.perf_counter() - started
    print_result("Estimator of contacts anywhere", content, json_output)


def _exported_arm(arm: str, out: Path, command: str, *, force: bool) -> dict[str, object]:
    from cablesense_sim.arm import find_arm, load_arm
    from cablesense_sim.uncertain_arm import arm_parameters
    from cablesense_training.law_export import export_law

    arm_file = find_arm(arm)
    output_file(out, force=force, inputs=(arm_file,))
    description = load_arm(arm_file)
    export_law(description, out, command)
    return {
        "out": str(out),
        "arm": description.identity,
        "bytes": out.stat().st_size,
        "parameters": len(arm_parameters(description)),
    }


def _exported_machine(file: str, out: Path, command: str, *, force: bool) -> dict[str, object]:
    from cablesense_sim.machine.machine import open_machine
    from cablesense_sim.machine.parameters import MachineParameters
    from cablesense_training.machine_export import export_machine

    machine = open_machine(file)
    output_file(out, force=force, inputs=(Path(file), machine.source.model_path))
    export_machine(machine, out, command)
    return {
        "out": str(out),
        "machine": machine.identity,
        "bytes": out.stat().st_size,
        "parameters": len(MachineParameters(machine)),
    }
