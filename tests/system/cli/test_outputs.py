"""No verb writes where it must not: before any work, in one line, and nothing is touched."""

import os

import pytest
from typer.testing import CliRunner

from cablesense_base import CableSenseError
from cablesense_ros.cli.app import app


def refused(*arguments):
    """The error of a command line; on files that a test leaves as they are."""
    error = CliRunner().invoke(app, list(map(str, arguments))).exception
    assert isinstance(error, CableSenseError), error
    assert "\n" not in str(error)
    return str(error)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("command", "file"),
    [
        ("dataset --workers 0 --out a.parquet", "a.parquet"),
        ("train --data none.parquet --out a.onnx", "a.onnx"),
        ("gap diagnose none.csv --out .", "report.html"),
        ("gap diagnose none.csv --out found", "found/amended_arm.yaml"),
        ("sensors calibrate none.csv --out a.yaml", "a.yaml"),
        ("replay none.mcap --estimates a.csv", "a.csv"),
        ("demo --model none.onnx --out mine", "mine/logs/sim.log"),
    ],
)
def test_what_exists_is_replaced_only_by_force(folder, command, file):
    path = folder / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("mine")
    assert f"{file}: exists already; " in refused(*command.split())
    assert f"{path.name}: exists already; " not in refused(*command.split(), "--force")
    assert path.read_text() == "mine"


def test_an_exported_model_replaces_another_only_by_force(folder):
    (folder / "a.onnx").write_text("mine")
    assert "a.onnx: exists already; " in refused("export", "--out", "a.onnx")
    assert (folder / "a.onnx").read_text() == "mine"


@pytest.mark.parametrize(
    ("command", "read"),
    [
        ("train --data a.parquet --out OUT", "a.parquet"),
        ("gap predict a.csv --out OUT", "a.csv"),
        ("urdf a.yaml --out OUT", "a.yaml"),
        ("sensors calibrate none.csv --map a.yaml --out OUT", "a.yaml"),
        ("replay a.mcap --estimates OUT", "a.mcap"),
    ],
)
def test_an_input_is_never_replaced_whatever_its_name(folder, command, read):
    (folder / read).write_text("mine")
    (folder / "hard_link").hardlink_to(folder / read)
    (folder / "link").symlink_to(folder / read)
    for name in (read, f"../{folder.name}/{read}", "hard_link", "link"):
        line = refused(*command.replace("OUT", name).split(), "--force")
        assert f"{name}: is an input of this command" in line
    assert (folder / read).read_text() == "mine"


def test_a_diagnosis_does_not_replace_the_arm_that_it_reads(folder):
    (folder / "amended_arm.yaml").write_text("mine")
    again = ("gap", "diagnose", "none.csv", "--arm", "amended_arm.yaml", "--out", ".", "--force")
    assert "amended_arm.yaml: is an input of this command" in refused(*again)


@pytest.mark.parametrize("force", [[], ["--force"]])
def test_a_device_a_pipe_and_a_read_only_file_are_refused_before_the_work(folder, force):
    os.mkfifo(folder / "pipe")
    (folder / "link").symlink_to("pipe")
    (folder / "fixed").touch(0o444)
    for name, why in (
        ("/dev/null", "is a device or a pipe"),
        ("pipe", "is a device or a pipe"),
        ("link", "is a device or a pipe"),
        ("fixed", "is read-only"),
        ("none/a", "No such file or directory"),
    ):
        assert f"{name}: cannot be written ({why}" in refused(
            "train", "--data", "none.parquet", "--out", name, *force
        )
    assert {path.name for path in folder.iterdir()} == {"pipe", "link", "fixed"}


def test_the_shape_of_an_arm_is_written_or_printed(folder):
    assert CliRunner().invoke(app, ["urdf", "cdsm", "--out", "arm.urdf"]).exit_code == 0
    assert "already" in refused("urdf", "cdsm", "--out", "arm.urdf")
    printed = CliRunner().invoke(app, ["urdf"]).stdout
    assert printed == (folder / "arm.urdf").read_text()
    assert "<collision>" in printed
