"""One sample at a time through a model, in buffers that stay where they are.

Binding inputs and outputs once spares ONNX Runtime's looking up of names, and the making of
arrays, at every sample.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_training.inference.metadata import ModelFileError
from cablesense_training.inference.session import TENSION, ModelSession

Array = NDArray[np.float64]


class SingleRun:
    """A model bound to buffers of one sample; not for use from several threads at once.

    Attributes:
        tension_difference_n: (M,) to be filled in before `run`.
        outputs: the model's outputs without the samples' axis, overwritten by `run`.
    """

    def __init__(self, session: ModelSession) -> None:
        arm = session.metadata.arm
        self._session = session
        self._tension = np.zeros((1, arm.cable_count))
        self._steady = session.steady_inputs(np.zeros((1, arm.joint_count)))
        self._buffers = session.run(self._tension, self._steady)
        self._moving = session.moving
        self._binding = self._moving.io_binding()
        for name, buffer in {TENSION: self._tension, **self._steady}.items():
            self._binding.bind_input(
                name, "cpu", 0, buffer.dtype.type, buffer.shape, buffer.ctypes.data
            )
        for entry, buffer in zip(self._moving.get_outputs(), self._buffers, strict=True):
            self._binding.bind_output(
                entry.name, "cpu", 0, buffer.dtype.type, buffer.shape, buffer.ctypes.data
            )
        self.tension_difference_n: Array = self._tension[0]
        self.outputs: list[Array] = [buffer.reshape(buffer.shape[1:]) for buffer in self._buffers]

    def set_command(self, joint_command_rad: Array) -> None:
        """Take over what the graph makes of commanded angles (1, 2N) alone."""
        for name, value in self._session.steady_inputs(joint_command_rad).items():
            np.copyto(self._steady[name], value)

    def run(self) -> None:
        """Answer for `tension_difference_n` at the command last set, into `outputs`.

        Raises:
            ModelFileError: ONNX Runtime cannot run the model.
        """
        try:
            self._moving.run_with_iobinding(self._binding)
        except Exception as error:  # ONNX Runtime's classes have no common base
            line = " ".join(str(error).split())[:200]
            raise ModelFileError(
                f"{self._session.source}: ONNX Runtime cannot run it ({line}); train it again"
            ) from error
