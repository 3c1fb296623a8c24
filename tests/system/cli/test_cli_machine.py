"""Verbs on recordings of a machine that MuJoCo describes: calibrate, info, estimate, evaluate."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from cablesense_recording.layout import layout_of
from cablesense_ros.cli.export import export
from cablesense_sim.machine.machine import open_machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce
from tests.helpers.example_machines import MACHINES, bent_command

pytestmark = [pytest.mark.exports, pytest.mark.slow]

PUSH_N = 1.5
DISTAL = 2
"""Number of the link that is pushed, from 1."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A finger with its model, a recording of its unloaded poses, and one of pushes."""
    folder = tmp_path_factory.mktemp("finger")
    for name in ("finger.xml", "finger.yaml"):
        shutil.copy(MACHINES / name, folder)
    export(out=folder / "finger.onnx", arm=str(folder / "finger.yaml"))
    machine = open_machine(folder / "finger.yaml")
    parameters = MachineParameters(machine)
    built = SimulatedMachine(machine, parameters, parameters.drawn(np.random.default_rng(2)))
    unloaded = [(bent_command(machine, seed), 0.0) for seed in range(8)]
    pushed = [(bent_command(machine, 20), push_n) for push_n in (0.0, PUSH_N)]
    recorded(folder / "poses.csv", machine, built, unloaded)
    recorded(folder / "pushed.csv", machine, built, pushed)
    return folder


def recorded(path, machine, built, stays):
    """Write a CSV of stays of two seconds at commands, untouched or pushed."""
    rng = np.random.default_rng(0)
    layout = layout_of(machine)
    middle_m = machine.links.touched_m[DISTAL - 1].mean()
    rows = []
    for command, push_n in stays:
        untouched = built.untouched(command)
        load_n = push_n * built.frames(command, untouched).axes[DISTAL - 1] @ [0.0, 0.6, 0.8]
        load = LinkForce(DISTAL - 1, np.array([middle_m, 0.0, 0.0]), load_n)
        values = built.under(command, [load], untouched.pose).values
        link = DISTAL if push_n else 0
        readings = machine.channels.read(np.tile(values, (40, 1)), rng)
        rows += [[*command, *reading, link, *load_n] for reading in readings]
    loads = ["load_segment", "load_x_n", "load_y_n", "load_z_n"]
    names = [*layout.command_columns, *layout.reading_columns, *loads]
    table = pd.DataFrame(rows, columns=names)
    table.insert(0, "time_s", 0.05 * np.arange(len(table)))
    table.to_csv(path, index=False)


@pytest.fixture
def calibrated(command, folder, tmp_path):
    """A calibration of the finger, and what the verb printed."""
    out = tmp_path / "finger.calibration"
    arm = folder / "finger.yaml"
    ended = command("calibrate", folder / "poses.csv", "--arm", arm, "--out", out, "--json")
    assert ended.returncode == 0, ended.stderr
    return out, json.loads(ended.stdout)


def test_a_machine_is_calibrated_and_info_shows_it(calibrated, command):
    out, content = calibrated
    assert content["poses"] == 8
    assert content["as_described"]
    known = content["force_known_n"]
    assert known["push"] == 1.0
    assert known["after"] < 0.5 * known["before"]
    kinds = {row["kind"]: row for row in content["parameters"]}
    assert kinds["sensor_gain"]["count"] == 4
    shown = json.loads(command("info", out, "--json").stdout)
    # the file says nothing of how forces bear on the machine
    assert shown == content | {"force_known_n": None}
    assert "tendon stiffness" in command("info", out).stdout


def test_pushes_are_estimated_and_judged(calibrated, command, folder, tmp_path):
    options = ("--arm", folder / "finger.yaml", "--calibration", calibrated[0], "--json")
    out = tmp_path / "estimates.csv"
    ended = command("estimate", folder / "pushed.csv", *options, "--out", out)
    assert ended.returncode == 0, ended.stderr
    strongest = json.loads(ended.stdout)["strongest"]
    assert strongest["segment"] == DISTAL
    assert strongest["magnitude_n"] == pytest.approx(PUSH_N, rel=0.05)
    assert out.with_suffix(".png").stat().st_size > 0

    ended = command("evaluate", "--recording", folder / "pushed.csv", *options)
    assert ended.returncode == 0, ended.stderr
    (errors,) = json.loads(ended.stdout).values()
    assert errors["by_segment"][str(DISTAL)]["errors"]["contact_accuracy"] == 1.0
    assert errors["all"]["errors"]["magnitude_mae_n"] < 0.05 * PUSH_N
    text = command("evaluate", "--recording", folder / "pushed.csv", *options[:-1]).stdout
    assert "distal" in text


def test_what_does_not_fit_is_refused(command, folder, tmp_path):
    arm = folder / "finger.yaml"
    out = tmp_path / "a.calibration"
    other = MACHINES / "six_axis.yaml"
    for arguments, said in (
        (("calibrate", folder / "poses.csv", "--arm", other, "--out", out), "cablesense export"),
        (("evaluate", "--recording", folder / "poses.csv", "--arm", "cdsm"), "no machine file"),
        (("evaluate", "--arm", arm), "--arm has no effect without --recording"),
    ):
        ended = command(*arguments)
        assert ended.returncode == 2
        assert said in ended.stderr
        assert ended.stderr.count("\n") == 1
