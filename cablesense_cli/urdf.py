"""`cablesense urdf`: an arm's shape for RViz, MoveIt and robot_state_publisher."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cablesense_base.files import OutputError, output_file, write_atomically
from cablesense_cli.options import ForceOption


def urdf(
    arm: Annotated[
        str, typer.Argument(help="Arm file: a path, or a bundled arm's name.")
    ] = "cdsm",
    out: Annotated[
        Path | None, typer.Option(help="Write it to this file.", show_default="standard output")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Write the URDF of an arm: links, joints, inertia, and shapes to see and to collide with.

    Joints have the names of joint_states; cables have no place in a URDF.

    Example: cablesense urdf my_arm.yaml --out my_arm.urdf
    """
    from cablesense_sim.arm import find_arm, load_arm
    from cablesense_sim.model import urdf_xml

    file = find_arm(arm)
    if out is None:
        print(urdf_xml(load_arm(file)))
        return
    output_file(out, force=force, inputs=(file,))
    write_atomically(out, urdf_xml(load_arm(file)) + "\n", OutputError)
