"""The pictures of docs/gallery.md: each bundled arm and example machine, touched (`make gallery`).

python .ci/gallery.py [name …]
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

PICTURES = Path("docs/images/gallery")
MACHINES = Path("config/machines")
COMMAND = (sys.executable, "-m", "cablesense_ros.cli.app")
TOUCHES = {
    "cdsm": ("3", 50.0, 215.0),
    "cdsm_lab": ("2", 60.0, 215.0),
    "finger": ("distal", 2.5, 215.0),
    "hand": ("index_distal", 2.0, 215.0),
    "seven_hinges": ("link_6", 15.0, 215.0),
    "continuum": ("link_20", 0.5, 100.0),
    "six_axis": ("tool", 40.0, 215.0),
}
"""Link, newtons and direction, degrees, by the name of an arm or of a machine file."""


def main(names: list[str]) -> None:
    """Draw the pictures of these names, by default of all."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as folder:
        for name in names or TOUCHES:
            link, newtons, angle_deg = TOUCHES[name]
            machine = MACHINES / f"{name}.yaml"
            model: list[str] = []
            if machine.is_file():
                exported = Path(folder) / f"{name}.onnx"
                run("export", "--arm", str(machine), "--out", str(exported))
                model = ["--model", str(exported)]
            source = str(machine) if model else name
            touch = ["--link", link, "--newtons", f"{newtons:g}", "--angle", f"{angle_deg:g}"]
            out = ["--out", str(PICTURES / f"{name}.png"), "--force"]
            run("picture", source, *model, *touch, *out)


def run(*arguments: str) -> None:
    """Run a verb of the command."""
    subprocess.run([*COMMAND, *arguments], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
