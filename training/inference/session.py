"""A model file opened: checked, tried, and ready to run on one processor core."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import onnxruntime

from cablesense_base import Array
from cablesense_base.files import read_bounded_bytes, write_atomically
from cablesense_sim.arm import Arm
from cablesense_training.inference.metadata import (
    MISFIT_KEY,
    MisfitLimit,
    ModelFileError,
    ModelMetadata,
)
from cablesense_training.inference.model_safety import require_bounded, require_harmless

MAX_FILE_BYTES = 64 * 1024 * 1024
"""Models are a fraction of a megabyte; a file beyond this is not one."""

_FEW = 64
"""Shorter constants are not worth a cast."""

_ROWS_AT_ONCE = 2048
"""A pose-aware graph holds some tens of kilobytes per sample while it runs."""

TENSION = "tension_difference_n"
COMMAND = "joint_command_rad"
SPEED = "joint_speed_rad_s"
ACCELERATION = "joint_acceleration_rad_s2"
STATE = "state"
NEXT_STATE = "next_state"
"""An output of models with memory: their `STATE` at the next tick."""
INTERVAL = "interval_n"
"""A further output of models with memory: between which the force lies with 95 %. Those of earlier
versions state its standard deviation alone."""
TAUT = "taut"
"""A further output of some models: 1 for taut cables, 0 for slack ones."""


@dataclass(frozen=True)
class ModelSession:
    """An ONNX model whose metadata has been read, and which has answered once.

    Attributes:
        source: the file, for messages.
        metadata: what the file states about itself.
        model: the graph.
        outputs: names of what it answers.
    """

    source: str
    metadata: ModelMetadata
    model: onnx.ModelProto
    outputs: tuple[str, ...]
    _whole: onnxruntime.InferenceSession

    @classmethod
    def open(
        cls, path: str | Path, outputs: Sequence[str], arm: Arm | None = None
    ) -> ModelSession:
        """Read a model file that gives `outputs` and, where an arm is named, fits it.

        A model made for the same arm without its effects or some of them, whatever that is named,
        fits as well: it answers without knowledge of the others.

        Raises:
            ModelFileError: unreadable, not ONNX, not a CableSense model, other outputs, or for
                another arm.
        """
        source = str(path)
        model, metadata = read_model(path)
        widen_constants(model.graph)
        if arm is not None and not _fits(metadata.arm, arm):
            raise ModelFileError(
                f"{source}: made for arm {metadata.arm_identity}, not for {arm.identity}; "
                "train one for this arm with `cablesense train --arm`"
            )
        _require_signature(model, metadata, outputs, source)
        try:
            require_bounded(model, source)
            session = cls(source, metadata, model, tuple(outputs), open_session(model))
        except ModelFileError:
            raise
        except Exception as error:  # ONNX Runtime and onnx raise a family of their own each
            raise cannot_run(source, error) from error
        session._require_answers()
        return session

    @property
    def beside(self) -> list[str]:
        """The further outputs of the model: `TAUT` or `INTERVAL`."""
        given = [entry.name for entry in self.model.graph.output]
        return [name for name in (TAUT, INTERVAL) if name in given]

    def run(
        self, inputs: Mapping[str, Array], outputs: Sequence[str] | None = None
    ) -> list[Array]:
        """The model's `outputs` for the inputs that `input_widths` names, each (B, width).

        Raises:
            ModelFileError: ONNX Runtime cannot run the model.
        """
        parts = []
        for start in range(0, len(inputs[TENSION]), _ROWS_AT_ONCE):
            rows = slice(start, start + _ROWS_AT_ONCE)
            part = {name: value[rows] for name, value in inputs.items()}
            try:
                parts.append(self._whole.run(list(outputs or self.outputs), part))
            except Exception as error:  # ONNX Runtime's classes have no common base
                raise cannot_run(self.source, error) from error
        return [np.concatenate(answers) for answers in zip(*parts, strict=True)]

    def _require_answers(self) -> None:
        """A file that opens may still not run; two idle arms at once show it."""
        arm, segments = self.metadata.arm, self.metadata.arm.segment_count
        shapes: dict[str, tuple[int, ...]] = {
            "contact_probability": (segments + 1,),
            "direction": (2,),
            INTERVAL: (2,),
            NEXT_STATE: (self.metadata.memory,),
            TAUT: (arm.cable_count,),
        }
        if self.metadata.kind == "multi-contact":
            shapes |= dict.fromkeys(self.outputs, (segments,))
        names = [*self.outputs, *self.beside]
        idle = {name: np.zeros((2, width)) for name, width in input_widths(self.metadata).items()}
        for name, answer in zip(names, self.run(idle, names), strict=True):
            shape = (2, *shapes.get(name, ()))
            if answer.dtype != np.float64 or answer.shape != shape:
                raise ModelFileError(
                    f"{self.source}: gives {name} as {answer.dtype} of shape {answer.shape} for "
                    f"two samples; needed is float64 of shape {shape}"
                )
            if not np.isfinite(answer).all():
                raise ModelFileError(
                    f"{self.source}: gives {name} that is not finite for an arm at rest; "
                    "train it again"
                )


def input_widths(metadata: ModelMetadata) -> dict[str, int]:
    """The inputs of a model with these metadata, and the width of each."""
    joints = metadata.arm.joint_count
    widths = {TENSION: metadata.arm.cable_count}
    if metadata.pose_aware:
        widths[COMMAND] = joints
    if metadata.memory:
        widths |= {SPEED: joints, ACCELERATION: joints, STATE: metadata.memory}
    return widths


def read_model(path: str | Path) -> tuple[onnx.ModelProto, ModelMetadata]:
    """The graph in a model file, and what the file states about itself; nothing is run.

    Raises:
        ModelFileError: unreadable, not ONNX, or not a CableSense model.
    """
    content = read_bounded_bytes(path, MAX_FILE_BYTES, "a model file (.onnx)", ModelFileError)
    try:
        model = onnx.load_model_from_string(content)
        require_harmless(model, str(path))
        onnx.checker.check_model(model)
    except ModelFileError:
        raise
    except Exception as error:  # protobuf and onnx raise whatever the broken place led to
        raise ModelFileError(
            f"{path}: not a valid ONNX file ({_line(error)}); needed is a model file, "
            "as `cablesense train` writes it"
        ) from error
    properties = {entry.key: entry.value for entry in model.metadata_props}
    return model, ModelMetadata.from_properties(properties, str(path))


def store_as_single(graph: onnx.GraphProto) -> None:
    """Store constants in float32 where that loses nothing, each followed by a cast to float64.

    A network is trained in float32 and answers in float64, so this halves its file.
    """
    casts, kept = [], []
    for constant in graph.initializer:
        values = onnx.numpy_helper.to_array(constant)
        single = values.astype(np.float32)
        if values.dtype != np.float64 or values.size < _FEW or not (single == values).all():
            kept.append(constant)
            continue
        kept.append(onnx.numpy_helper.from_array(single, f"{constant.name}_single"))
        names = [kept[-1].name], [constant.name]
        casts.append(onnx.helper.make_node("Cast", *names, to=onnx.TensorProto.DOUBLE))
    nodes = [*casts, *graph.node]
    del graph.initializer[:], graph.node[:]
    graph.initializer.extend(kept)
    graph.node.extend(nodes)


def widen_constants(graph: onnx.GraphProto) -> None:
    """Undo `store_as_single`: a constant behind a cast would be a result in a split graph."""
    single = {constant.name: constant for constant in graph.initializer}
    for node in list(graph.node):
        if node.op_type == "Cast" and node.input[0] in single:
            values = onnx.numpy_helper.to_array(single[node.input[0]]).astype(np.float64)
            single[node.input[0]].CopyFrom(onnx.numpy_helper.from_array(values, node.output[0]))
            graph.node.remove(node)


def replace_misfit_limit(path: Path, limit: MisfitLimit | None) -> None:
    """Put another limit of the misfit, or none, into a model file; all else of it stays.

    Raises:
        ModelFileError: no model file, or it cannot be written.
    """
    model, _ = read_model(path)
    write_atomically(path, _with_misfit_limit(model, limit), ModelFileError)


def model_sha256(path: str | Path) -> str:
    """SHA-256 of a model file without its limit of the misfit, which no estimate follows from.

    Raises:
        ModelFileError: no model file.
    """
    model, _ = read_model(path)
    return hashlib.sha256(_with_misfit_limit(model, None)).hexdigest()


def _with_misfit_limit(model: onnx.ModelProto, limit: MisfitLimit | None) -> bytes:
    kept = [entry for entry in model.metadata_props if entry.key != MISFIT_KEY]
    del model.metadata_props[:]
    model.metadata_props.extend(kept)
    if limit is not None:
        model.metadata_props.add(key=MISFIT_KEY, value=limit.model_dump_json())
    return model.SerializeToString()


def _fits(made_for: Arm, arm: Arm) -> bool:
    """Whether a model's arm is an arm, but for its name and for effects that it lacks."""
    known = made_for.nominal.model_copy(update={"name": arm.name})
    lacks_some = all(effect in arm.effects for effect in made_for.effects)
    return known.identity == arm.nominal.identity and lacks_some


def _require_signature(
    model: onnx.ModelProto, metadata: ModelMetadata, outputs: Sequence[str], source: str
) -> None:
    given = [output.name for output in model.graph.output]
    if given not in (list(outputs), [*outputs, TAUT], [*outputs, INTERVAL]):
        raise ModelFileError(
            f"{source}: a {metadata.kind} model that gives {', '.join(given)}; "
            f"needed are {', '.join(outputs)}"
        )
    needed = {name: ("DOUBLE", [0, width]) for name, width in input_widths(metadata).items()}
    kinds = {number: name for name, number in onnx.TensorProto.DataType.items()}
    found = {}
    for entry in model.graph.input:
        tensor = entry.type.tensor_type
        kind = kinds.get(tensor.elem_type, f"type {tensor.elem_type}")
        found[entry.name] = kind, [dim.dim_value for dim in tensor.shape.dim]
    if found != needed:
        shown, right = (
            ", ".join(f"{name} ({kind} {dims})" for name, (kind, dims) in listed.items())
            for listed in (found, needed)
        )
        raise ModelFileError(
            f"{source}: takes {shown[:400]}; its metadata need {right} (0: any number)"
        )


def cannot_run(source: str, error: Exception) -> ModelFileError:
    """The error for a model on which ONNX Runtime gave up."""
    return ModelFileError(f"{source}: ONNX Runtime cannot run it ({_line(error)}); train it again")


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def open_session(model: onnx.ModelProto) -> onnxruntime.InferenceSession:
    """A session of a model or a part of one, on one thread and silent."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    return onnxruntime.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
