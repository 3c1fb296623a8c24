"""A model opened: tried, run for any number of samples, or quickly for one after another.

For single samples, inputs and outputs are bound once to buffers that stay where they are. The
graph is split into three parts by how often their results change: commands change seldom, the set
of slack cables now and then, tensions a thousand times a second. The part that depends on the
command alone is *steady*; what depends on the command and on one named tensor is *held* while that
tensor stays the same; the rest is *moving*, and computes that tensor too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar, NamedTuple, Self

import numpy as np
import onnx
import onnx.utils
import onnxruntime
from onnx import GraphProto, ModelProto, TensorProto

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_training.errors import ModelFileError
from cablesense_training.inference.metadata import ModelMetadata
from cablesense_training.inference.model_file import (
    one_line,
    read_model,
    require_bounded,
    widen_constants,
)

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


def input_widths(metadata: ModelMetadata) -> dict[str, int]:
    """The inputs of a model with these metadata, and the width of each."""
    joints = metadata.arm.joint_count
    widths = {TENSION: metadata.arm.cable_count}
    if metadata.pose_aware:
        widths[COMMAND] = joints
    if metadata.memory:
        widths |= {SPEED: joints, ACCELERATION: joints, STATE: metadata.memory}
    return widths


class OpenedModel:
    """A model whose file has been checked, and which has answered once; for one thread at a time.

    Attributes:
        beside: the further outputs of the model: `TAUT` or `INTERVAL`, or none.
    """

    outputs: ClassVar[Sequence[str]]

    def __init__(self, path: str | Path, arm: Arm | None = None) -> None:
        self._source = str(path)
        self.model, self.metadata = read_model(path)
        widen_constants(self.model.graph)
        made_for = self.metadata
        if arm is not None and not fits(made_for.arm, arm):
            raise ModelFileError(
                f"{path}: made for arm {made_for.arm_identity}, not for {arm.identity}; "
                "train one for this arm with `cablesense train --arm`"
            )
        given = [output.name for output in self.model.graph.output]
        self.beside = given[len(self.outputs) :]
        if given != [*self.outputs, *self.beside] or self.beside not in ([], [TAUT], [INTERVAL]):
            raise ModelFileError(
                f"{path}: a {made_for.kind} model that gives {', '.join(given)[:400]}; "
                f"needed are {', '.join(self.outputs)}"
            )
        try:
            require_bounded(self.model, self._source)
            self._whole = open_session(self.model)
        except ModelFileError:
            raise
        except Exception as error:  # ONNX Runtime and onnx raise a family of their own each
            raise _cannot_run(self._source, error) from error
        self._require_answers()

    @classmethod
    def load(cls, path: str | Path, arm: Arm | None = None) -> Self:
        """Open a model file, for a certain arm where one is given.

        A model made for the same arm without its effects or some of them fits as well, whatever
        that is named.

        Raises:
            ModelFileError: the file is no model of this kind, or not one for this arm.
        """
        return cls(path, arm)

    @property
    def pose_aware(self) -> bool:
        """Whether the model needs the commanded joint angles."""
        return self.metadata.pose_aware

    def run(
        self, inputs: Mapping[str, Array], outputs: Sequence[str] | None = None
    ) -> list[Array]:
        """The model's `outputs` for the inputs that `input_widths` names, each (B, width).

        A `ModelFileError` says why ONNX Runtime cannot run it.
        """
        parts = []
        for start in range(0, len(inputs[TENSION]), _ROWS_AT_ONCE):
            rows = slice(start, start + _ROWS_AT_ONCE)
            part = {name: value[rows] for name, value in inputs.items()}
            try:
                parts.append(self._whole.run(list(outputs or self.outputs), part))
            except Exception as error:  # ONNX Runtime's classes have no common base
                raise _cannot_run(self._source, error) from error
        return [np.concatenate(answers) for answers in zip(*parts, strict=True)]

    def _require_answers(self) -> None:
        """A file that opens may still not run or take other inputs; two idle arms show it."""
        arm, segments = self.metadata.arm, self.metadata.arm.segment_count
        shapes: dict[str, tuple[int, ...]] = {
            "contact_probability": (segments + 1,),
            "direction": (2,),
            INTERVAL: (2,),
            NEXT_STATE: (self.metadata.memory,),
            TAUT: (arm.cable_count,),
            "torque_n_m": (arm.joint_count,),
            "precision": (arm.joint_count, arm.joint_count),
            "by_force_m": (segments, 3, arm.joint_count),
            "by_place": (segments, 3, arm.joint_count),
            "by_twist": (segments, arm.joint_count),
            "residual": (arm.cable_count,),
        }
        if self.metadata.kind == "multi-contact":
            shapes |= dict.fromkeys(self.outputs, (segments,))
        names = [*self.outputs, *self.beside]
        idle = {name: np.zeros((2, width)) for name, width in input_widths(self.metadata).items()}
        for name, answer in zip(names, self.run(idle, names), strict=True):
            shape = (2, *shapes.get(name, ()))
            fits = answer.dtype == np.float64 and answer.shape == shape
            if not fits or not np.isfinite(answer).all():
                raise ModelFileError(
                    f"{self._source}: gives {name} as {answer.dtype} of shape {answer.shape} for "
                    f"two idle arms, or not finite; needed are finite numbers, float64 of {shape}"
                )


def fits(made_for: Arm, arm: Arm) -> bool:
    """Whether a model's arm is an arm, but for its name and for effects that it lacks."""
    known = made_for.nominal.model_copy(update={"name": arm.name})
    lacks_some = all(effect in arm.effects for effect in made_for.effects)
    return known.identity == arm.nominal.identity and lacks_some


def _cannot_run(source: str, error: Exception) -> ModelFileError:
    return ModelFileError(
        f"{source}: ONNX Runtime cannot run it ({one_line(error)}); train it again"
    )


def open_session(model: ModelProto) -> onnxruntime.InferenceSession:
    """A session of a model or a part of one, on one thread and silent."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    return onnxruntime.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )


class GraphParts(NamedTuple):
    """Parts of one graph; a part's outputs are inputs of later parts, by the same names.

    Those in which there is nothing to keep are None.
    """

    steady: ModelProto | None
    held: ModelProto | None
    moving: ModelProto


def split_graph(model: ModelProto, changing: str, held: str | None = None) -> GraphParts:
    """Split a model by whether its tensors depend on the input `changing`, or only on `held`.

    `held` names a tensor that depends on `changing`; without it there is no held part.
    """
    graph = model.graph
    direct = _reached(graph, {changing}, stop=held)
    through_held = _reached(graph, {held} if held else set()) - direct
    moving_nodes = [node for node in graph.node if direct.intersection(node.output)]
    held_nodes = [node for node in graph.node if through_held.intersection(node.output)]
    final = [output.name for output in graph.output]
    made = {name for node in graph.node for name in node.output if name}

    def taken(from_these: set[str], *later: onnx.NodeProto) -> list[str]:
        names = [name for node in later for name in node.input] + final
        return [name for name in dict.fromkeys(names) if name in from_these]

    steady_out = taken(made - direct - through_held, *held_nodes, *moving_nodes)
    held_out = taken(made & through_held, *moving_nodes)
    if not steady_out and not held_out:
        return GraphParts(None, None, model)
    extractor = onnx.utils.Extractor(_typed(model, made))
    fixed = [entry.name for entry in graph.input if entry.name != changing]
    known = [*fixed, *steady_out]
    return GraphParts(
        extractor.extract_model(fixed, steady_out) if steady_out else None,
        extractor.extract_model([*known, str(held)], held_out) if held_out else None,
        extractor.extract_model([changing, *known, *held_out], final),
    )


def _reached(graph: GraphProto, sources: set[str], stop: str | None = None) -> set[str]:
    """Tensors that depend on `sources`; the dependence is not followed through `stop`."""
    reached = set(sources)
    for node in graph.node:
        if any(name in reached and name != stop for name in node.input):
            reached.update(node.output)
    return reached


def _typed(model: ModelProto, made: set[str]) -> ModelProto:
    """The model with a type for every tensor (unknown ones are doubles), and no shape.

    Shapes would let ONNX Runtime fuse operators differently, and so change last digits.
    """
    typed = onnx.shape_inference.infer_shapes(model)
    kinds = {v.name: v.type.tensor_type.elem_type for v in typed.graph.value_info}
    del typed.graph.value_info[:]
    typed.graph.value_info.extend(
        onnx.helper.make_tensor_value_info(name, kinds.get(name) or TensorProto.DOUBLE, None)
        for name in sorted(made.difference(output.name for output in typed.graph.output))
    )
    return typed


_Bound = tuple[onnxruntime.InferenceSession, onnxruntime.IOBinding]


class SingleRun:
    """A model bound to buffers of one sample; a `ModelFileError` says why it cannot be run.

    Attributes:
        tension_difference_n: (M,) to be filled in before `run`.
        outputs: the model's outputs without the samples' axis, overwritten by `run`.
    """

    def __init__(self, model: ModelProto, arm: Arm, outputs: Sequence[str], source: str) -> None:
        self._source = source
        self._buffers = {
            TENSION: np.zeros((1, arm.cable_count)),
            COMMAND: np.zeros((1, arm.joint_count)),
            TAUT: np.ones((1, arm.cable_count)),
        }
        self._taut = b""
        try:
            tells_taut = any(output.name == TAUT for output in model.graph.output)
            parts = split_graph(model, TENSION, TAUT if tells_taut else None)
            self._steady, self._held, self._moving = (
                None if part is None else self._bound(open_session(part)) for part in parts
            )
        except Exception as error:  # onnx and ONNX Runtime have families of their own
            raise _cannot_run(source, error) from error
        self.tension_difference_n: Array = self._buffers[TENSION][0]
        answers = [self._buffers[name] for name in outputs]
        self.outputs: list[Array] = [answer.reshape(answer.shape[1:]) for answer in answers]

    def _bound(self, session: onnxruntime.InferenceSession) -> _Bound:
        """A part with its inputs and outputs in this run's buffers; new outputs get new ones."""
        inputs = {entry.name: self._buffers[entry.name] for entry in session.get_inputs()}
        names = [entry.name for entry in session.get_outputs()]
        for name, value in zip(names, session.run(names, inputs), strict=True):
            self._buffers.setdefault(name, value)
        binding = session.io_binding()
        for bind, bound in ((binding.bind_input, inputs), (binding.bind_output, names)):
            for name in bound:
                buffer = self._buffers[name]
                bind(name, "cpu", 0, buffer.dtype.type, buffer.shape, buffer.ctypes.data)
        return session, binding

    def set_command(self, joint_command_rad: Array) -> None:
        """Take over what the graph makes of commanded angles (1, 2N) alone."""
        self._buffers[COMMAND][:] = joint_command_rad
        self._run(self._steady)
        self._taut = b""

    def run(self) -> None:
        """Answer for `tension_difference_n` at the command last set, into `outputs`."""
        self._run(self._moving)
        if self._held is None:
            return
        # the answer stands if the cables found taut are those that the held part is for
        taut = self._buffers[TAUT].tobytes()
        if taut != self._taut:
            self._run(self._held)
            self._run(self._moving)
            self._taut = taut

    def _run(self, part: _Bound | None) -> None:
        if part is None:
            return
        session, binding = part
        try:
            session.run_with_iobinding(binding)
        except Exception as error:  # ONNX Runtime's classes have no common base
            raise _cannot_run(self._source, error) from error
