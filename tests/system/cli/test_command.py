"""The command: help that is fast and light, one-line errors with exit code 2, figures as JSON."""

import os
import re
import signal
import subprocess
import sys
import time
from urllib.request import urlopen

import pytest
from typer.testing import CliRunner

from cablesense_gap.amended_arm import write_arm
from cablesense_ros.cli.app import app
from cablesense_sim.arm import open_arm
from tests.helpers.arm_variants import variant

COMMAND = [sys.executable, "-c", "from cablesense_ros.cli.app import main; main()"]
VERBS = ("demo", "export", "dataset", "train", "evaluate", "info", "gap", "sensors")
GAP_VERBS = ("diagnose", "predict", "protocol", "record", "score", "watch")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("", VERBS),
        ("gap", GAP_VERBS),
        *((verb, ()) for verb in VERBS),
        *((f"gap {verb}", ["Examples?"]) for verb in GAP_VERBS),
    ],
)
def test_every_verb_explains_itself(words, says):
    result = CliRunner().invoke(app, [*words.split(), "--help"])
    assert result.exit_code == 0
    assert len(result.output.splitlines()) > 8
    assert all(re.search(rf"\b{word}\b", result.output) for word in says)


@pytest.mark.slow
def test_help_loads_neither_ros_nor_torch_nor_the_page():
    code = (
        "import sys; from cablesense_ros.cli.app import app;"
        "print(*(m for m in ('rclpy', 'torch', 'viser', 'mujoco', 'onnxruntime', 'matplotlib',"
        " 'pandas', 'rosbags', 'jinja2', 'scipy') if m in sys.modules))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == ""
    assert result.returncode == 0


END_OF_VERB = "-- end of a verb --"
ENCODINGS = ("latin-1", "cp1252", "koi8-r", "ascii")
ONE_AFTER_THE_OTHER = f"""
import sys
from cablesense_ros.cli.app import main
for encoding in {ENCODINGS!r}:
    for words in ("info cdsm", "info --effects", "gap protocol"):
        sys.stdout.reconfigure(encoding=encoding, errors="strict")
        sys.argv = ["cablesense", *words.split()]
        try:
            main()
        except SystemExit as end:
            assert not end.code, (encoding, words)
        print({END_OF_VERB!r})
"""
"""Verbs in one process, each of which would import everything again."""


@pytest.mark.slow
def test_a_terminal_without_some_letters_shows_the_others():
    """One process has one terminal after the other."""
    environment = os.environ | {"PYTHONIOENCODING": ENCODINGS[0]}
    result = subprocess.run(
        [sys.executable, "-c", ONE_AFTER_THE_OTHER], capture_output=True, env=environment
    )
    assert result.returncode == 0, result.stderr
    *shown, end = result.stdout.split(END_OF_VERB.encode("ascii"))
    assert len(shown) == 3 * len(ENCODINGS)
    for place, text in enumerate(shown):
        assert text.decode(ENCODINGS[place // 3]).strip()
    assert not end.strip()


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (["info", "nonsense"], "bundled arms are cdsm"),
        (["info", "missing.yaml"], "no arm file missing.yaml"),
        (["info", "robot.xml"], "gap diagnose, adapt, predict, protocol and watch take it"),
        (["estimate", "missing.csv"], "missing.csv: no such file"),
        (["info", "missing.onnx"], "no model file missing.onnx"),
        (["info", "broken.onnx"], "not a valid ONNX file"),
        (["evaluate", "--model", "nonsense"], "bundled models are"),
        (["evaluate", "--table2", "--model", "cdsm_anywhere"], "cdsm_table2"),
        (["evaluate", "--recording", "loads.csv"], "--recording needs --model"),
        (["demo", "--arm", "nonsense"], "bundled arms are cdsm"),
        (["demo", "--headless", "--model", "missing.onnx"], "no model file missing.onnx"),
        (["demo", "--arm", "own.yaml"], "cablesense export --arm own.yaml --out own.onnx"),
        (["demo", "--out", "/proc/none"], "give another --out"),
        (["gap", "diagnose", "missing.csv", "--out", "d"], "missing.csv: no such"),
        (["gap", "diagnose", "r.csv", "--arm", "x.yaml", "--out", "d"], "no arm file x.yaml"),
        (["gap", "predict", "missing.mcap", "--out", "p.csv"], "missing.mcap"),
        (["gap", "score", "missing", "--answers", "missing.csv"], "missing.csv"),
        (["sensors", "check", "none.csv"], "none.csv: no such file"),
        (["sensors", "check", "--pull", "cable_99"], "no cable 'cable_99'"),
        (["sensors", "calibrate", "none.csv", "--out", "c.yaml"], "none.csv: cannot be read"),
        (["gap", "record", "--arm", "nonsense", "--out", "r.mcap"], "bundled arms are cdsm"),
    ],
)
def test_wrong_input_is_one_line_with_a_remedy(arguments, remedy, command, tmp_path):
    (tmp_path / "broken.onnx").write_bytes(b"not a model")
    (tmp_path / "robot.xml").write_text("<mujoco/>")
    write_arm(tmp_path / "own.yaml", variant({"name": "own"}), "")
    result = command(*arguments)
    assert result.returncode == 2
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("cablesense: ")
    assert remedy in lines[0]
    given = {"broken.onnx", "robot.xml", "own.yaml"}
    assert {path.name for path in tmp_path.iterdir()} == given


@pytest.mark.slow
@pytest.mark.ros
def test_a_demo_serves_its_page_and_ends_cleanly_when_told_to(tmp_path):
    pytest.importorskip("rclpy", reason="needs rclpy")
    pytest.importorskip("viser", reason="needs viser")
    process = subprocess.Popen(
        [*COMMAND, "demo", "--port", "18480", "--no-open", "--out", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    with process:
        line = next(line for line in process.stdout if "http://" in line)
        url = re.search(r"open (http://127\.0\.0\.1:\d+/[\w-]{22}/) in a browser", line)[1]
        with urlopen(url) as answer:
            assert answer.status == 200
        assert (tmp_path / "logs/page.log").stat().st_mode & 0o077 == 0
        log = (tmp_path / "logs/page.log").read_text()
        assert f"page of arm {open_arm('cdsm_lab').identity}" in log
        children = child_pids(process.pid)
        assert len(children) == 4  # sim, estimator, commissioner, page
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 143
        assert "Traceback" not in process.stderr.read()
    time.sleep(0.1)
    assert not any(os.path.exists(f"/proc/{pid}") for pid in children)  # noqa: PTH110
    assert not any("Traceback" in log.read_text() for log in tmp_path.rglob("*.log"))


def child_pids(pid):
    with open(f"/proc/{pid}/task/{pid}/children") as children:  # noqa: PTH123
        return [int(child) for child in children.read().split()]


BLOCKED = """
import sys
missing = sys.argv.pop(1).split(',')
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split('.')[0] in missing:
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)
sys.meta_path.insert(0, Absent())
"""
"""The beginning of a program for which the libraries named first are not installed."""

SPARING = """
from cablesense_contact import LawModel, find_model
from cablesense_training import Dataset, draw_dataset
LawModel(find_model("cdsm_anywhere"))
import cablesense_ros.sim_node, cablesense_ros.estimator_node, cablesense_ros.demo
from cablesense_ros.cli.app import app, main
try:
    app(["evaluate", "--table2"])
except SystemExit as end:
    assert not end.code, end
sys.argv = ["cablesense", "train", "--out", "p.onnx"]
main()
"""
"""An estimator, the nodes and a verb need none of the libraries; another verb does."""


@pytest.mark.slow
def test_a_library_that_is_not_installed_is_missed_by_no_other_verb_and_named(tmp_path):
    libraries = "pandas,rosbags,jinja2,torch,pyarrow,sklearn"
    result = subprocess.run(
        [sys.executable, "-c", BLOCKED + SPARING, libraries],
        capture_output=True,
        text=True,
        timeout=100,
        cwd=tmp_path,
    )
    assert result.returncode == 2, result.stderr
    (line,) = result.stderr.strip().splitlines()
    assert "package torch" in line  # the first that it needs
    assert "make setup" in line
