"""One sample at a time through a model, each part of its graph no oftener than needed.

Inputs and outputs are bound once to buffers that stay where they are, which spares ONNX Runtime's
looking up of names, and the making of arrays, at every sample. The graph is split into three parts
by how often their results change. Commands change seldom, the set of slack cables now and then,
tensions a thousand times a second. The part that depends on the command alone is *steady*; what
depends on the command and on one named tensor is *held* while that tensor stays the same; the rest
is *moving*, and computes that tensor too.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import onnx
import onnx.utils
import onnxruntime
from onnx import GraphProto, ModelProto, NodeProto, TensorProto

from cablesense_base import Array
from cablesense_training.inference.session import (
    COMMAND,
    TAUT,
    TENSION,
    ModelSession,
    cannot_run,
    open_session,
)


class GraphParts(NamedTuple):
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
    graph = model.graph
    direct = _reached(graph, {changing}, stop=held)
    through_held = _reached(graph, {held} if held else set()) - direct
    moving_nodes = [node for node in graph.node if direct.intersection(node.output)]
    held_nodes = [node for node in graph.node if through_held.intersection(node.output)]
    final = [output.name for output in graph.output]
    later = direct | through_held
    steady_out = _taken(set(_made(graph.node)) - later, [*held_nodes, *moving_nodes], final)
    held_out = _taken(set(_made(held_nodes)), moving_nodes, final)
    if not steady_out and not held_out:
        return GraphParts(None, None, model)
    extractor = onnx.utils.Extractor(_typed(model))
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


def _made(nodes: Iterable[NodeProto]) -> list[str]:
    return [name for node in nodes for name in node.output if name]


def _taken(made: set[str], later: list[NodeProto], final: list[str]) -> list[str]:
    """Which of these tensors later nodes, or the user of the model, take."""
    names = [name for node in later for name in node.input] + final
    return [name for name in dict.fromkeys(names) if name in made]


def _typed(model: ModelProto) -> ModelProto:
    """The model with a type for every tensor (unknown ones are doubles), and no shape.

    Shapes would let ONNX Runtime fuse operators differently, and so change last digits.
    """
    typed = onnx.shape_inference.infer_shapes(model)
    kinds = {v.name: v.type.tensor_type.elem_type for v in typed.graph.value_info}
    del typed.graph.value_info[:]
    outer = {entry.name for entry in typed.graph.output}
    typed.graph.value_info.extend(
        onnx.helper.make_tensor_value_info(name, kinds.get(name) or TensorProto.DOUBLE, None)
        for name in _made(typed.graph.node)
        if name not in outer
    )
    return typed


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
        arm = session.metadata.arm
        self._source = session.source
        self._buffers = {
            TENSION: np.zeros((1, arm.cable_count)),
            COMMAND: np.zeros((1, arm.joint_count)),
            TAUT: np.ones((1, arm.cable_count)),
        }
        self._taut = b""
        try:
            parts = split_graph(session.model, TENSION, TAUT if TAUT in session.beside else None)
            self._steady, self._held, self._moving = (
                None if part is None else self._bound(open_session(part)) for part in parts
            )
        except Exception as error:  # onnx and ONNX Runtime have families of their own
            raise cannot_run(session.source, error) from error
        self.tension_difference_n: Array = self._buffers[TENSION][0]
        answers = [self._buffers[name] for name in session.outputs]
        self.outputs: list[Array] = [answer.reshape(answer.shape[1:]) for answer in answers]

    def _bound(
        self, session: onnxruntime.InferenceSession
    ) -> tuple[onnxruntime.InferenceSession, onnxruntime.IOBinding]:
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
        """Take over what the graph makes of commanded angles (1, 2N) alone.

        Raises:
            ModelFileError: ONNX Runtime cannot run the model.
        """
        self._buffers[COMMAND][:] = joint_command_rad
        self._run(self._steady)
        self._taut = b""

    def run(self) -> None:
        """Answer for `tension_difference_n` at the command last set, into `outputs`.

        The answer stands if the cables found taut are those that the held part was computed for.

        Raises:
            ModelFileError: ONNX Runtime cannot run the model.
        """
        self._run(self._moving)
        if self._held is None:
            return
        taut = self._buffers[TAUT].tobytes()
        if taut != self._taut:
            self._run(self._held)
            self._run(self._moving)
            self._taut = taut

    def _run(
        self, part: tuple[onnxruntime.InferenceSession, onnxruntime.IOBinding] | None
    ) -> None:
        if part is None:
            return
        session, binding = part
        try:
            session.run_with_iobinding(binding)
        except Exception as error:  # ONNX Runtime's classes have no common base
            raise cannot_run(self._source, error) from error
