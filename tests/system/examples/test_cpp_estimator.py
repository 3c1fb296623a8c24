"""The C++ example: its inputs and outputs are the model's, and it answers as Python does."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from cablesense_contact.calibration import Calibrator
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.law import GRAPH_INPUTS, LawOutput
from cablesense_online.models import load_model
from examples.cpp_estimator import known
from tests.helpers.checkout import CHECKOUT

SOURCE = CHECKOUT / "examples/cpp_estimator/estimator.cpp"


def names(what):
    block = re.search(rf"{what}{{(.*?)}}", SOURCE.read_text(encoding="utf-8"), re.DOTALL)[1]
    return re.findall(r'"(\w+)"', block)


def test_it_names_the_inputs_in_order_and_outputs_that_there_are():
    assert tuple(names("inputs")) == GRAPH_INPUTS
    assert set(names("outputs")) <= set(LawOutput._fields)


def test_what_is_known_is_written_as_mean_and_covariance(tmp_path):
    out = tmp_path / "known.bin"
    known.main("cdsm_lab", str(out))
    loaded = load_model("cdsm_lab", "")
    calibration = Calibrator(FeltArm(loaded.arm), loaded.model).by_tolerances()
    numbers = np.fromfile(out)
    size = len(calibration.mean)
    np.testing.assert_array_equal(numbers[:size], calibration.mean)
    np.testing.assert_array_equal(numbers[size:].reshape(size, size), calibration.covariance)


def onnx_runtime():
    """Flags of a C++ ONNX Runtime, if one is installed."""
    if shutil.which("pkg-config") is None or shutil.which("g++") is None:
        return None
    asked = ["pkg-config", "--cflags", "--libs", "libonnxruntime"]
    answered = subprocess.run(asked, capture_output=True, text=True, check=False)
    return answered.stdout.split() if answered.returncode == 0 else None


@pytest.mark.slow
@pytest.mark.skipif(onnx_runtime() is None, reason="needs ONNX Runtime for C++")
def test_compiled_it_answers_as_python_does(tmp_path):
    program = tmp_path / "estimator"
    command = ["g++", "-std=c++17", str(SOURCE), "-o", str(program), *onnx_runtime()]
    subprocess.run(command, check=True)
    out = tmp_path / "known.bin"
    known.main("cdsm_lab", str(out))
    loaded = load_model("cdsm_lab", "")
    calibration = Calibrator(FeltArm(loaded.arm), loaded.model).by_tolerances()
    reading = 50.0 + np.linspace(-10.0, 10.0, 12)
    still = np.zeros((8, 8))
    seen = loaded.model(reading[None], still[:1], calibration.mean, calibration.covariance, still)
    line = " ".join(map(repr, [*reading.tolist(), *[0.0] * 8])) + "\n"
    said = subprocess.run(
        [str(program), loaded.path, str(out)],
        input=line,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    numbers = [float(n) for n in re.findall(r"-?\d+\.\d+", said)]
    assert numbers[1:4] == pytest.approx(seen.force_n[0].tolist(), abs=1e-3)
