"""One sample at a time through a model, each part of its graph no oftener than needed.

Inputs and outputs are bound once to buffers that stay where they are, which spares ONNX Runtime's
looking up of names, and the making of arrays, at every sample. The graph is split into three parts
by how often what they compute changes. Commands change seldom, the set of slack cables now and
then, tensions a thousand times a second. What depends on the command alone is *steady*; what
depends on the command and on one named tensor is *held* while that tensor stays the same; the rest
is *moving*, and computes that tensor too.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import onnx
import onnxruntime
from onnx import GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto, helper

from cablesense_base.arrays import Array
from cablesense_training.inference.session import (
    COMMAND,
    TAUT,
    TENSION,
    ModelSession,
    cannot_run,
    open_session,
)


@dataclass(frozen=True)
class GraphParts:
    """Parts of one graph; a part's outputs are inputs of later parts, by the same names.

    Attributes:
        steady: from the inputs that do not change; None where there is nothing in it to keep.
        held: from those, the steady part and the held tensor; None likewise.
        moving: from all that and the changing input to the graph's outputs.
    """

    steady: ModelProto | None
    held: ModelProto | None
    moving: ModelProto


def split_graph(model: ModelProto, changing: str, held: str | None = None) -> GraphParts:
    """Split a model by whether its tensors depend on the input `changing`, or only on `held`.

    `held` names a tensor that depends on `changing`; without it there is no held part.
    """
    direct = _reached(model.graph, {changing}, stop=held)
    through_held = _reached(model.graph, {held} if held else set())
    steady_nodes, held_nodes, moving_nodes = [], [], []
    for node in model.graph.node:
        if direct.intersection(node.output):
            moving_nodes.append(node)
        elif through_held.intersection(node.output):
            held_nodes.append(node)
        else:
            steady_nodes.append(node)
    values = _Values(model)
    final = [output.name for output in model.graph.output]
    steady_out = values.wanted(steady_nodes, [*held_nodes, *moving_nodes], final)
    held_out = values.wanted(held_nodes, moving_nodes, final)
    return GraphParts(
        steady=values.part(steady_nodes, steady_out) if steady_out else None,
        held=values.part(held_nodes, held_out) if held_out else None,
        moving=values.part(moving_nodes, final) if steady_out or held_out else model,
    )


def _reached(graph: GraphProto, sources: set[str], stop: str | None = None) -> set[str]:
    """Tensors that depend on `sources`; the dependence is not followed through `stop`."""
    reached = set(sources)
    for node in graph.node:
        if any(name in reached and name != stop for name in node.input):
            reached.update(node.output)
    return reached


class _Values:
    """A model's tensors, and parts of its graph made of them."""

    def __init__(self, model: ModelProto) -> None:
        self._model = model
        self._inputs = {entry.name: entry for entry in model.graph.input}
        self._outputs = {entry.name: entry for entry in model.graph.output}
        self._types = _tensor_types(model)
        self._constants = {entry.name for entry in model.graph.initializer}

    def wanted(
        self, nodes: list[NodeProto], later: list[NodeProto], final: Iterable[str]
    ) -> list[str]:
        """What these nodes make that later ones, or the user of the model, take."""
        taken = {name for node in later for name in node.input} | set(final)
        return [name for node in nodes for name in node.output if name in taken]

    def part(self, nodes: list[NodeProto], outputs: list[str]) -> ModelProto:
        """The nodes as a model of their own that gives `outputs`."""
        made = {name for node in nodes for name in node.output} | self._constants | {""}
        taken = [name for node in nodes for name in node.input if name not in made]
        taken += [name for name in outputs if name not in made]
        used = {name for node in nodes for name in node.input} | set(outputs)
        graph = helper.make_graph(
            nodes,
            self._model.graph.name,
            [self._value(name) for name in dict.fromkeys(taken)],
            [self._value(name) for name in outputs],
            initializer=[v for v in self._model.graph.initializer if v.name in used],
        )
        return helper.make_model(
            graph, opset_imports=self._model.opset_import, ir_version=self._model.ir_version
        )

    def _value(self, name: str) -> ValueInfoProto:
        known = self._inputs.get(name) or self._outputs.get(name)
        return known or helper.make_tensor_value_info(name, self._types[name], None)


def _tensor_types(model: ModelProto) -> dict[str, int]:
    inferred = onnx.shape_inference.infer_shapes(model).graph
    known = [*inferred.value_info, *inferred.input, *inferred.output]
    types = {value.name: value.type.tensor_type.elem_type for value in known}
    missing = {
        name: TensorProto.DOUBLE
        for node in model.graph.node
        for name in node.output
        if types.get(name, TensorProto.UNDEFINED) == TensorProto.UNDEFINED
    }
    return types | missing


class SingleRun:
    """A model bound to buffers of one sample; not for use from several threads at once.

    Attributes:
        tension_difference_n: (M,) to be filled in before `run`.
        outputs: the model's outputs without the samples' axis, overwritten by `run`.
    """

    def __init__(self, session: ModelSession) -> None:
        """Split and bind a model.

        Raises:
            ModelFileError: it answers for two samples, but its parts cannot for one.
        """
        self._source = session.source
        try:
            self._bind(session)
        except Exception as error:  # onnx and ONNX Runtime have families of their own
            raise cannot_run(session.source, error) from error

    def _bind(self, session: ModelSession) -> None:
        arm = session.metadata.arm
        held = TAUT if session.gives_taut else None
        parts = split_graph(session.model, TENSION, held)
        self._buffers = {
            TENSION: np.zeros((1, arm.cable_count)),
            COMMAND: np.zeros((1, arm.joint_count)),
            TAUT: np.ones((1, arm.cable_count)),
        }
        self._taut: bytes | None = b"" if parts.held is not None else None
        self._parts = [
            self._bound(open_session(part))
            for part in (parts.steady, parts.held, parts.moving)
            if part is not None
        ]
        self._steady = self._parts[0] if parts.steady is not None else None
        self._held = self._parts[-2] if parts.held is not None else None
        self._moving, self._moving_binding = self._parts[-1]
        self.tension_difference_n: Array = self._buffers[TENSION][0]
        answers = [self._buffers[name] for name in session.outputs]
        self.outputs: list[Array] = [answer.reshape(answer.shape[1:]) for answer in answers]
        self._taut_now = self._buffers[TAUT]

    def set_command(self, joint_command_rad: Array) -> None:
        """Take over what the graph makes of commanded angles (1, 2N) alone.

        Raises:
            ModelFileError: ONNX Runtime cannot run the model.
        """
        self._buffers[COMMAND][:] = joint_command_rad
        if self._steady is not None:
            self._run(*self._steady)
        if self._taut is not None:
            self._taut = b""

    def run(self) -> None:
        """Answer for `tension_difference_n` at the command last set, into `outputs`.

        The answer stands if the cables found taut are those that the held part was computed for.

        Raises:
            ModelFileError: ONNX Runtime cannot run the model.
        """
        self._run(self._moving, self._moving_binding)
        if self._taut is None or self._held is None:
            return
        taut = self._taut_now.tobytes()
        if taut != self._taut:
            self._run(*self._held)
            self._run(self._moving, self._moving_binding)
            self._taut = taut

    def _bound(
        self, session: onnxruntime.InferenceSession
    ) -> tuple[onnxruntime.InferenceSession, onnxruntime.IOBinding]:
        """A part with its inputs and outputs in this run's buffers; new outputs get new ones."""
        inputs = {entry.name: self._buffers[entry.name] for entry in session.get_inputs()}
        names = [entry.name for entry in session.get_outputs()]
        for name, value in zip(names, session.run(names, inputs), strict=True):
            self._buffers.setdefault(name, value)
        binding = session.io_binding()
        for name, buffer in inputs.items():
            binding.bind_input(name, "cpu", 0, buffer.dtype.type, buffer.shape, buffer.ctypes.data)
        for name in names:
            buffer = self._buffers[name]
            binding.bind_output(
                name, "cpu", 0, buffer.dtype.type, buffer.shape, buffer.ctypes.data
            )
        return session, binding

    def _run(self, session: onnxruntime.InferenceSession, binding: onnxruntime.IOBinding) -> None:
        try:
            session.run_with_iobinding(binding)
        except Exception as error:  # ONNX Runtime's classes have no common base
            raise cannot_run(self._source, error) from error
