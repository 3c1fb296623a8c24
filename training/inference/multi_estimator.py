"""The multi-contact estimator: from tension differences to touched segments and their forces."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_sim.arm import Arm
from cablesense_training.inference.estimator import NO_ANSWER, EstimateError, finite_table
from cablesense_training.inference.session import ModelSession

Array = NDArray[np.float64]

OUTPUTS = ("contact_probability", "magnitude_n", "magnitude_std_n")


@dataclass(frozen=True)
class MultiEstimates:
    """B estimates of an arm with N segments, all (B, N).

    Attributes:
        probabilities: that a segment is touched.
        magnitude_n: force on it, meant where it is touched.
        magnitude_std_n: stated standard deviation.
    """

    probabilities: Array
    magnitude_n: Array
    magnitude_std_n: Array


class MultiEstimator:
    """A multi-contact model, opened.

    Attributes:
        metadata: what the model file says about itself.
    """

    def __init__(self, session: ModelSession) -> None:
        self.metadata = session.metadata
        self._session = session

    @classmethod
    def load(cls, path: str | Path, arm: Arm | None = None) -> MultiEstimator:
        """Open a model file, for a certain arm where one is given.

        Raises:
            ModelFileError: the file is no multi-contact model, or not one for this arm.
        """
        return cls(ModelSession.open(path, OUTPUTS, arm))

    def estimate_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> MultiEstimates:
        """The contacts behind tension differences (B, M) or (M,).

        A pose-aware model needs the commanded angles, (B, 2N) or (2N,), too.

        Raises:
            EstimateError: wrong shape, not finite, or a command that is missing.
        """
        arm = self.metadata.arm
        tension = _columns(tension_differences_n, arm.cable_count, "tension differences")
        commands = None
        if self.metadata.pose_aware:
            if joint_commands_rad is None:
                raise EstimateError(
                    f"this model needs the {arm.joint_count} commanded joint angles"
                )
            command = _columns(joint_commands_rad, arm.joint_count, "commanded joint angles")
            if len(command) not in (1, len(tension)):
                raise EstimateError(
                    f"{len(command)} commands for {len(tension)} samples; give one, or one each"
                )
            command = np.broadcast_to(command, (len(tension), arm.joint_count))
            commands = np.ascontiguousarray(command)
        probability, magnitude, std = self._session.run(tension, commands)
        if not all(np.isfinite(part).all() for part in (probability, magnitude, std)):
            raise EstimateError(NO_ANSWER)
        return MultiEstimates(probability, magnitude, std)


def _columns(values: ArrayLike, columns: int, what: str) -> Array:
    table = finite_table(values, what)
    if table.shape[1] != columns:
        raise EstimateError(
            f"{what} of shape {np.shape(values)}; this model needs {columns} a sample"
        )
    return table
