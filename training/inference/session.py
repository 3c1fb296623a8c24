"""A model file opened: checked, and ready to run on one processor core."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from cablesense_sim.arm import Arm
from cablesense_training.inference.metadata import ModelFileError, ModelMetadata
from cablesense_training.inference.partition import split_graph

Array = NDArray[np.float64]

MAX_FILE_BYTES = 64 * 1024 * 1024
"""Models are a fraction of a megabyte; a file beyond this is not one."""

TENSION = "tension_difference_n"
COMMAND = "joint_command_rad"


@dataclass(frozen=True)
class ModelSession:
    """An ONNX model whose metadata has been read.

    Attributes:
        source: the file, for messages.
        metadata: what the file says about itself.
    """

    source: str
    metadata: ModelMetadata
    _moving: onnxruntime.InferenceSession
    _steady: onnxruntime.InferenceSession | None

    @classmethod
    def open(cls, path: str | Path, outputs: Sequence[str], arm: Arm | None = None) -> ModelSession:
        """Read a model file that gives `outputs` and, where an arm is named, fits it.

        Raises:
            ModelFileError: unreadable, not ONNX, not a CableSense model, other outputs, or for another arm.
        """
        source = str(path)
        model = _read(Path(path))
        properties = {entry.key: entry.value for entry in model.metadata_props}
        metadata = ModelMetadata.from_properties(properties, source)
        if arm is not None and arm.identity != metadata.arm_identity:
            raise ModelFileError(
                f"{source}: made for arm {metadata.arm_identity}, not for {arm.identity}; "
                "train one for this arm with `cablesense train --arm`"
            )
        _require_signature(model, metadata, outputs, source)
        try:
            steady, moving = split_graph(model, TENSION)
            return cls(
                source,
                metadata,
                _session(moving),
                None if steady is None else _session(steady),
            )
        except Exception as error:  # ONNX Runtime and onnx raise a family of their own each
            line = " ".join(str(error).split())[:200]
            raise ModelFileError(f"{source}: ONNX Runtime cannot run it ({line})") from error

    def steady_inputs(self, joint_commands_rad: Array) -> dict[str, Array]:
        """What the graph makes of commanded angles (B, 2N) alone, for `run`."""
        if self._steady is None:
            return {COMMAND: joint_commands_rad} if self.metadata.pose_aware else {}
        names = [output.name for output in self._steady.get_outputs()]
        values = self._steady.run(names, {COMMAND: joint_commands_rad})
        steady = dict(zip(names, values, strict=True))
        if any(entry.name == COMMAND for entry in self._moving.get_inputs()):
            steady[COMMAND] = joint_commands_rad
        return steady

    def run(self, tension_differences_n: Array, steady: dict[str, Array]) -> list[Array]:
        """The model's outputs, in the order of `open`, for tension differences (B, M)."""
        outputs: list[Array] = self._moving.run(None, {TENSION: tension_differences_n, **steady})
        return outputs


def _read(path: Path) -> onnx.ModelProto:
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ModelFileError(f"{path}: larger than {MAX_FILE_BYTES} bytes, so not a model file")
        content = path.read_bytes()
    except OSError as error:
        raise ModelFileError(f"{path}: cannot be read ({error.strerror})") from error
    try:
        model = onnx.load_model_from_string(content)
        onnx.checker.check_model(model)
    except (DecodeError, onnx.checker.ValidationError, ValueError, TypeError) as error:
        line = " ".join(str(error).split())[:200]
        raise ModelFileError(f"{path}: not a valid ONNX file ({line})") from error
    return model


def _require_signature(
    model: onnx.ModelProto, metadata: ModelMetadata, outputs: Sequence[str], source: str
) -> None:
    given = [output.name for output in model.graph.output]
    if given != list(outputs):
        raise ModelFileError(
            f"{source}: a {metadata.kind} model that gives {', '.join(given)}; needed are {', '.join(outputs)}"
        )
    expected = {TENSION: metadata.arm.cable_count}
    if metadata.pose_aware:
        expected[COMMAND] = metadata.arm.joint_count
    found = {
        entry.name: entry.type.tensor_type.shape.dim[-1].dim_value
        for entry in model.graph.input
        if entry.type.tensor_type.shape.dim
    }
    if found != expected:
        raise ModelFileError(f"{source}: takes inputs {found}; its own metadata say {expected}")


def _session(model: onnx.ModelProto) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
