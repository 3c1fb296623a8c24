"""The examples that need no running node: each runs, and says what is true."""

import re

import jupytext
import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image

from examples import own_arm, own_effect, own_robot, push_animation
from tests.helpers.checkout import CHECKOUT

pytestmark = pytest.mark.exports


def test_a_sensor_reads_nothing_below_its_threshold(capsys):
    own_effect.main()
    assert capsys.readouterr().out.replace(" ", "") == "[[5.0.3.]\n[5.1.43.]]\n"


@pytest.mark.slow
def test_a_model_for_an_own_arm_estimates_a_push(tmp_path, capsys):
    pytest.importorskip("torch")
    own_arm.main(tmp_path)
    true, estimated, interval = capsys.readouterr().out.splitlines()[-3:]
    assert numbers(estimated) == pytest.approx(numbers(true), rel=0.1)
    _, low_n, high_n = numbers(interval)
    assert low_n < numbers(true)[-1] < high_n


@pytest.mark.slow
def test_friction_of_an_own_robot_is_found(tmp_path, capsys):
    own_robot.main(*own_robot.planted(tmp_path))
    printed = capsys.readouterr().out
    friction_text = re.search(r"torque_n_m: (\S+) N·m", printed)[1]
    assert float(friction_text) == pytest.approx(own_robot.FRICTION_N_M[1], rel=0.05)
    headline = printed.splitlines()[0]
    for page in ("README.md", "docs/robot.md"):
        text = (CHECKOUT / page).read_text(encoding="utf-8")
        assert headline in text.replace("\n> ", " "), page


def test_a_step_backs_off_above_the_threshold_and_up_to_the_limit():
    pytest.importorskip("rclpy")
    from examples.back_off import LIMIT_RAD, THRESHOLD_N, next_command_rad

    torques_n_m = [0.0, -2.0]
    assert next_command_rad([0.0, 0.1], torques_n_m, 0.9 * THRESHOLD_N) == [0.0, 0.1]
    turned_rad = next_command_rad([0.0, 0.1], torques_n_m, 1.1 * THRESHOLD_N)
    assert turned_rad[0] == 0.0
    assert turned_rad[1] < 0.1
    assert next_command_rad([LIMIT_RAD] * 2, [2.0, 2.0], 1.1 * THRESHOLD_N) == [LIMIT_RAD] * 2


@pytest.mark.slow
def test_the_animation_moves(tmp_path):
    push_animation.main(tmp_path / "push.gif", frames=6)  # two of each push
    with Image.open(tmp_path / "push.gif") as animation:
        assert animation.n_frames == 6
        first = np.asarray(animation.convert("RGB"))
        animation.seek(1)
        assert (first != np.asarray(animation.convert("RGB"))).any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("estimate_csv", r"5\.0 s  contact on segment_3, .*: 5\d\.\d+ to 6\d\.\d+ N"),
        ("diagnose_recording", r"payload \(\d+%\)\n.*\n  payload\.mass_kg: 0\.1"),
    ],
)
def test_a_notebook_has_the_cells_of_its_script_and_runs(
    name, says, tmp_path, monkeypatch, capsys
):
    notebook, script = (
        jupytext.read(CHECKOUT / f"examples/{name}{end}") for end in (".ipynb", ".py")
    )
    assert [cell.source for cell in notebook.cells] == [cell.source for cell in script.cells]
    assert not any(cell.get("outputs") for cell in notebook.cells)
    monkeypatch.chdir(tmp_path)
    values = {}
    for cell in notebook.cells:
        if cell.cell_type == "code":
            exec(compile(cell.source, name, "exec"), values)
    plt.close("all")
    said = capsys.readouterr().out
    assert re.search(says, said), said
    assert list(tmp_path.glob(f"out/{name}/*.png"))


def numbers(line):
    return [float(number) for number in re.findall(r"[\d.]+\d|\d", line)]
