"""One sample at a time through a model, each part of its graph no oftener than needed.

Inputs and outputs are bound once to buffers that stay where they are, which spares ONNX Runtime's
looking up of names, and the making of arrays, at every sample.
"""

from __future__ import annotations

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from cablesense_training.inference.partition import split_graph
from cablesense_training.inference.session import (
    COMMAND,
    TAUT,
    TENSION,
    ModelSession,
    open_session,
)

Array = NDArray[np.float64]


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
        self._session = session
        try:
            self._bind(session)
        except Exception as error:  # onnx and ONNX Runtime have families of their own
            raise session.cannot_run(error) from error

    def _bind(self, session: ModelSession) -> None:
        arm = session.metadata.arm
        held = TAUT if session.tells_taut else None
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
            raise self._session.cannot_run(error) from error
