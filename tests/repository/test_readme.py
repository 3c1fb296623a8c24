"""The example of the README estimates a push."""

import re

import numpy as np
import pytest

from cablesense_sim import mechanism_of, normal_force_n, open_arm, solve_equilibrium
from tests.helpers.checkout import CHECKOUT

README = (CHECKOUT / "README.md").read_text(encoding="utf-8")


def test_the_example_of_the_readme_estimates_a_push():
    mechanism = mechanism_of(open_arm("cdsm_lab"))
    command_rad = np.deg2rad([5.0, 0.0, -5.0, 3.0, 0.0, 0.0, 2.0, -4.0])
    push_n = normal_force_n(mechanism, command_rad, segment=3, angle_deg=215.0, magnitude_n=20.0)
    loads_n = [np.zeros_like(push_n), push_n]
    untouched_n, reading_n = solve_equilibrium(
        mechanism, [command_rad, command_rad], loads_n
    ).tensions_n
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    values = {"untouched_n": untouched_n, "reading_n": reading_n, "command_rad": command_rad}
    exec(compile(example, "README.md", "exec"), values)
    touch = values["touch"]
    assert touch.link == "segment_3"
    assert touch.magnitude_n == pytest.approx(20.0, abs=1.0)
    assert f"# {touch}\n" in example
