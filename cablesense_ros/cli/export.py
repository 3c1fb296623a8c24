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

    Example: cablesense export --arm my_arm.yaml --out my_arm.onnx
    """
    from cablesense_sim.arm import find_arm, load_arm
    from cablesense_sim.uncertain_arm import arm_parameters
    from cablesense_training.law_export import export_law

    arm_file = find_arm(arm)
    output_file(out, force=force, inputs=(arm_file,))
    description = load_arm(arm_file)
    started = time.perf_counter()
    export_law(description, out, command_line("export", {"arm": arm, "out": out}))
    content = {
        "out": str(out),
        "arm": description.identity,
        "bytes": out.stat().st_size,
        "parameters": len(arm_parameters(description)),
        "seconds": time.perf_counter() - started,
    }
    print_result("Estimator of contacts anywhere", content, json_output)
