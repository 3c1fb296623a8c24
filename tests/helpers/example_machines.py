"""The example machines, small ones from text, and commands near their reference poses."""

from functools import cache
from pathlib import Path
from textwrap import dedent

import numpy as np

from cablesense_base import Array
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.machine import Machine, open_machine

MACHINES = Path(__file__).parents[2] / "config" / "machines"

ROD_LINKS = 5
ROD_LENGTH_M = 0.04
ROD_SERVO_N_M = 8000.0

ROD_FILE = """
joints: actuators
sensors:
  tension: {of: [wire], noise_std: 0.01}
cables: {pretension_n: 3}
touch:
  friction: 0.3
  largest_n: 5
  links:
    - {link: link_5, start_m: [0.0395, 0, 0], end_m: [0.0405, 0, 0], radius_m: 0.003}
"""


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


def machine_of_two_motors(folder: Path, pretension_n: float, largest_n: float) -> Machine:
    """A weightless hinge between two tendons with motors, 30 mm from it; its joint is measured."""
    file = _TWO_MOTORS_FILE.format(pretension_n=pretension_n, largest_n=largest_n)
    return written_machine(folder, _TWO_MOTORS, file)


def rod_model(axis: str = "0 1 0", across: str = "") -> str:
    """A rod of links on springs, bent by one wire above it that a servo draws.

    With an axis `across` every link has a second hinge about it.
    """
    inside = ""
    second = ""
    for n in range(ROD_LINKS, 0, -1):
        at_m = ROD_LENGTH_M if n > 1 else 0.0
        if across:
            spring = 'type="hinge" stiffness="1.5" damping="0.1"'
            second = f'<joint name="sway_{n}" axis="{across}" {spring}/>'
        inside = f"""
        <body name="link_{n}" pos="{at_m} 0 0">
          <joint name="bend_{n}" type="hinge" axis="{axis}" stiffness="1.5" damping="0.1"/>
          {second}
          <geom type="capsule" fromto="0 0 0 {ROD_LENGTH_M} 0 0" size="0.003" mass="0.008"/>
          <site name="guide_{n}" pos="{ROD_LENGTH_M / 2} 0 0.006"/>
          {inside}
        </body>"""
    guides = "".join(f'<site site="guide_{n}"/>' for n in range(ROD_LINKS + 1))
    return f"""
    <mujoco>
      <option timestep="0.001"/>
      <worldbody><site name="guide_0" pos="-0.01 0 0.006"/>{inside}</worldbody>
      <tendon><spatial name="wire">{guides}</spatial></tendon>
      <actuator><position name="motor" tendon="wire" kp="{ROD_SERVO_N_M}"/></actuator>
    </mujoco>"""


_TWO_MOTORS = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <site name="left" pos="0 0.03 0"/>
    <site name="right" pos="0 -0.03 0"/>
    <body name="link" pos="0.05 0 0">
      <joint name="turn" axis="0 0 1" range="-40 40"/>
      <geom type="capsule" fromto="0.01 0 0 0.2 0 0" size="0.01" mass="0.1"/>
      <site name="left_end" pos="0.05 0.03 0"/>
      <site name="right_end" pos="0.05 -0.03 0"/>
    </body>
  </worldbody>
  <tendon>
    <spatial name="left"><site site="left"/><site site="left_end"/></spatial>
    <spatial name="right"><site site="right"/><site site="right_end"/></spatial>
  </tendon>
  <actuator>
    <motor tendon="left" ctrlrange="-100 0"/>
    <motor tendon="right" ctrlrange="-100 0"/>
  </actuator>
</mujoco>
"""
_TWO_MOTORS_FILE = """
joints: measured
cables: {{pretension_n: {pretension_n}}}
sensors:
  tension: {{of: [left, right], noise_std: 0.05}}
touch:
  largest_n: {largest_n}
  links:
    - {{link: link, start_m: [0.01, 0, 0], end_m: [0.2, 0, 0], radius_m: 0.01}}
"""
