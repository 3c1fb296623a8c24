"""The command: help that is fast and light, one-line errors with exit code 2, figures as JSON."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from urllib.request import urlopen

import pytest
from typer.testing import CliRunner

from cablesense_gap.recordings.csv_file import all_columns
from cablesense_ros.cli.app import app
from cablesense_sim.arm import open_arm

COMMAND = [sys.executable, "-c", "from cablesense_ros.cli.app import main; main()"]
VERBS = ("demo", "dataset", "train", "evaluate", "info", "paper", "gap", "sensors")
GAP_VERBS = ("diagnose", "predict", "protocol", "record", "score", "withhold")


def run(*arguments, **options):
    return subprocess.run(
        [*COMMAND, *arguments], capture_output=True, text=True, timeout=60, **options
    )


def test_help_names_every_verb():
    result = CliRunner().invoke(app, ["--help"])
    assert result.exit_code == 0
    assert all(re.search(rf"\b{verb}\b", result.output) for verb in VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_explains_itself(verb):
    result = CliRunner().invoke(app, [verb, "--help"])
    assert result.exit_code == 0
    assert len(result.output.splitlines()) > 8


def test_help_of_the_diagnosis_names_every_verb():
    result = CliRunner().invoke(app, ["gap", "--help"])
    assert result.exit_code == 0
    assert all(re.search(rf"\b{verb}\b", result.output) for verb in GAP_VERBS)


@pytest.mark.parametrize("verb", GAP_VERBS)
def test_every_verb_of_the_diagnosis_explains_itself(verb):
    result = CliRunner().invoke(app, ["gap", verb, "--help"])
    assert result.exit_code == 0
    assert "Example" in result.output


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


def test_version_is_shown():
    result = CliRunner().invoke(app, ["--version"])
    assert result.exit_code == 0
    assert re.match(r"cablesense \d+\.\d+\.\d+", result.output)


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (["info", "nonsense"], "bundled arms are cdsm"),
        (["info", "missing.yaml"], "no arm file missing.yaml"),
        (["info", "missing.onnx"], "no model file missing.onnx"),
        (["demo", "--arm", "nonsense"], "bundled arms are cdsm"),
        (["demo", "--headless", "--model", "missing.onnx"], "no model file missing.onnx"),
        (["demo", "--out", "/proc/none"], "give another --out"),
        (["gap", "diagnose", "missing.csv", "--out", "d"], "missing.csv: no such"),
        (["gap", "diagnose", "r.csv", "--arm", "x.yaml", "--out", "d"], "no arm file x.yaml"),
        (["gap", "predict", "missing.mcap", "--out", "p.csv"], "missing.mcap"),
        (["gap", "score", "missing", "--answers", "missing.csv"], "missing.csv"),
        (["gap", "withhold", "--count", "1", "--only", "rust", "--out", "w"], "no effect 'rust'"),
        (["paper", "--out", "p", "--only", "fig99"], "no study 'fig99'; there are"),
        (["paper", "--out", "/proc/none"], "give another --out"),
        (["sensors", "check", "none.csv"], "none.csv: no such file"),
        (["sensors", "calibrate", "none.csv", "--out", "c.yaml"], "none.csv: cannot be read"),
        (["gap", "record", "--arm", "nonsense", "--out", "r.mcap"], "bundled arms are cdsm"),
    ],
)
def test_wrong_input_is_one_line_with_a_remedy(arguments, remedy, command, tmp_path):
    result = command(*arguments)
    assert result.returncode == 2
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("cablesense: ")
    assert remedy in lines[0]
    assert list(tmp_path.rglob("*.png")) == []


def test_a_file_that_is_no_model_is_refused(command, tmp_path):
    path = tmp_path / "broken.onnx"
    path.write_bytes(b"not a model")
    result = command("info", path)
    assert result.returncode == 2
    assert "not a valid ONNX file" in result.stderr


def assert_one_line_on_output(returncode, stderr, why):
    assert returncode == 2
    (line,) = stderr.strip().splitlines()
    assert line.startswith(f"cablesense: standard output cannot be written ({why}); send it")


@pytest.mark.slow
@pytest.mark.parametrize("arguments", ["info", "info --json", "--help", "--version"])
def test_output_that_cannot_be_written_is_one_line(arguments):
    command, errors = [*COMMAND, *arguments.split()], {"stderr": subprocess.PIPE, "text": True}
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = subprocess.run(command, stdout=full, **errors)
    assert_one_line_on_output(done.returncode, done.stderr, "No space left on device")
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(command, stdout=writer, **errors)
    os.close(writer)
    assert_one_line_on_output(done.returncode, done.stderr, "Broken pipe")


@pytest.mark.slow
@pytest.mark.parametrize("where", [">&-", "2>&-", "2>/dev/full", ">/dev/full 2>&1"])
def test_errors_that_nobody_can_read_end_with_2_too(where):
    command = f"{sys.executable} -c '{COMMAND[-1]}' info nonsense {where}"
    assert subprocess.run(command, shell=True, capture_output=True).returncode == 2


@pytest.mark.slow
def test_info_of_an_arm_as_json():
    result = run("info", "cdsm", "--json")
    description = json.loads(result.stdout)
    assert result.returncode == 0
    assert description["identity"].startswith("cdsm-")
    assert [cable["ends_on_segment"] for cable in description["cables"]] == [
        1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4,
    ]  # fmt: skip
    assert [cable["angle_deg"] for cable in description["cables"][3:6]] == [30.0, 270.0, 150.0]
    assert description["cables"][0]["radius_m"] == pytest.approx(0.05)


def test_info_of_an_arm_as_tables():
    result = CliRunner().invoke(app, ["info", "cdsm_table2"])
    assert result.exit_code == 0
    assert "cable_9" in result.output
    assert "cable_10" not in result.output


@pytest.mark.slow
def test_info_of_the_bundled_model_says_what_it_was_made_for():
    from cablesense_base.installation import config_path

    result = run("info", str(config_path("models/cdsm.onnx")), "--json")
    description = json.loads(result.stdout)
    names = [port["name"] for port in description["inputs"]]
    assert "tension_difference_n" in names
    assert description["metadata"]


@pytest.mark.slow
@pytest.mark.ros
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_demo_ends_cleanly_when_told_to(tmp_path, number, code):
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
        if number == signal.SIGTERM:
            choose_another_arm(url)
            line = next(line for line in process.stdout if "http://" in line)
            assert url in line
            log = (tmp_path / "logs/page.log").read_text()
            assert f"page of arm {open_arm('cdsm_table2').identity}" in log
        children = child_pids(process.pid)
        assert len(children) == 3
        process.send_signal(number)
        assert process.wait(15) == code
        assert "Traceback" not in process.stderr.read()
    time.sleep(0.1)
    assert not any(os.path.exists(f"/proc/{pid}") for pid in children)  # noqa: PTH110
    assert not any("Traceback" in log.read_text() for log in tmp_path.rglob("*.log"))


def choose_another_arm(url):
    from page_visitor import ConnectionClosed, Visitor

    visitor = Visitor(url)
    while "arm" not in visitor.read().controls:
        pass
    visitor.put("arm", "../../else")  # does nothing
    visitor.put("arm", "cdsm_table2")
    with pytest.raises(ConnectionClosed):
        visitor.read(30.0)


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

COMMAND_TEXT = "from cablesense_ros.cli.app import main\nmain()\n"


def run_without(libraries, *arguments, program=COMMAND_TEXT):
    return subprocess.run(
        [sys.executable, "-c", BLOCKED + program, libraries, *arguments],
        capture_output=True,
        text=True,
        timeout=60,
    )


@pytest.mark.slow
def test_a_library_that_is_not_installed_is_named_with_the_remedy():
    result = run_without("torch", "train")
    assert result.returncode == 2
    assert len(result.stderr.strip().splitlines()) == 1
    assert "package torch" in result.stderr
    assert "make setup" in result.stderr


@pytest.mark.slow
def test_a_diagnosis_says_which_library_it_lacks(tmp_path):
    path = tmp_path / "recording.csv"
    arm = open_arm("cdsm_lab")
    names = all_columns(arm.joint_count, arm.cable_count)
    path.write_text(f"{','.join(names)}\n{','.join('0' for _ in names)}\n")
    result = run_without("pandas", "gap", "predict", str(path), "--out", str(tmp_path / "p.csv"))
    assert result.returncode == 2
    assert len(result.stderr.strip().splitlines()) == 1
    assert "package pandas" in result.stderr


GAP_LIBRARIES = "pandas,rosbags,jinja2"


@pytest.mark.slow
def test_what_is_no_diagnosis_needs_none_of_its_libraries(tmp_path):
    assert run_without(GAP_LIBRARIES, "--help").returncode == 0
    assert run_without(GAP_LIBRARIES, "gap", "--help").returncode == 0
    result = run_without(GAP_LIBRARIES, "info", "cdsm_lab", "--json")
    assert result.returncode == 0, result.stderr
    modules = "cablesense_ros.sim_node, cablesense_ros.estimator_node, cablesense_ros.demo.run"
    loaded = run_without(GAP_LIBRARIES, program=f"import {modules}")
    assert loaded.returncode == 0, loaded.stderr


@pytest.mark.slow
def test_evaluation_needs_no_library_for_files():
    result = run_without("torch,pyarrow", "evaluate", "--table2")
    assert result.returncode == 0, result.stderr
    assert "21.20 N" in result.stdout
