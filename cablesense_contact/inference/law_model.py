"""A model file that holds the law of an arm: the whole estimator as one graph, opened and run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cablesense_base import Array
from cablesense_contact.commands import require_commands
from cablesense_contact.errors import EstimateError, ModelFileError
from cablesense_contact.inference.metadata import ANYWHERE
from cablesense_contact.inference.model_file import read_model
from cablesense_contact.inference.session import EXPORT_AGAIN, cannot_run, fits, open_session
from cablesense_contact.law import GRAPH_INPUTS, LawOutput
from cablesense_sim.arm import Arm
from cablesense_sim.uncertain_arm import arm_parameters

_ROWS_AT_ONCE = 256
"""A row holds some hundred kilobytes while it runs."""
_MOST_TOGETHER = 8
"""A call of the graph costs as much as one or two rows: with eight most of that is saved."""


class LawModel:
    """The law in a model file; a `cablesense_contact.law.Law`.

    Attributes:
        metadata: what the file states about itself.
    """

    most_together = _MOST_TOGETHER

    def __init__(self, path: str | Path, arm: Arm | None = None) -> None:
        """Open a model file, for a certain arm where one is given.

        Raises:
            ModelFileError: the file is no such model, or not one of this arm.
        """
        self._source = str(path)
        model, self.metadata = read_model(path)
        made_for = self.metadata
        if made_for.kind != ANYWHERE:
            raise ModelFileError(f"{path}: a {made_for.kind} model; needed is one of {ANYWHERE}")
        if arm is not None and not fits(made_for.arm, arm):
            raise ModelFileError(
                f"{path}: made for arm {made_for.arm_identity}, not for {arm.identity}; make one "
                "for this arm with `cablesense export --arm`"
            )
        if arm is not None and made_for.arm.touch != arm.touch:
            raise ModelFileError(
                f"{path}: made for contacts on {made_for.arm.touch}, and the arm file now states "
                f"{arm.touch}; make it again with `cablesense export`"
            )
        inputs = tuple(entry.name for entry in model.graph.input)
        answers = tuple(entry.name for entry in model.graph.output)
        if inputs != GRAPH_INPUTS or answers != LawOutput._fields:
            raise ModelFileError(
                f"{path}: a model of contacts anywhere of an earlier version, without tolerances; "
                "make it again with `cablesense export` (seconds)"
            )
        try:
            self._session = open_session(model)
        except Exception as error:  # ONNX Runtime and onnx raise a family of their own each
            raise cannot_run(self._source, error, EXPORT_AGAIN) from error
        self._require_answers()

    @property
    def arm(self) -> Arm:
        """The arm that the model was made for."""
        return self.metadata.arm

    def __call__(
        self,
        reading_n: Array,
        command_rad: Array,
        mean: Array,
        covariance: Array,
        unrest_n2_m2: Array,
    ) -> LawOutput:
        """What readings (B, M) say at commands (B, 2N), by parameters with a mean (P,).

        The parameters have the covariance (P, P), torques by motion `unrest_n2_m2` (2N, 2N).

        Raises:
            EstimateError: a reading or a command is not finite, or a command is more than half a
                turn.
            ModelFileError: ONNX Runtime cannot run it.
        """
        require_commands(command_rad)
        if not np.isfinite(reading_n).all():
            raise EstimateError("readings must be finite; one is NaN or infinite")
        parts = []
        for first in range(0, len(reading_n), _ROWS_AT_ONCE):
            rows = slice(first, first + _ROWS_AT_ONCE)
            inputs = (reading_n[rows], command_rad[rows], mean, covariance, unrest_n2_m2)
            try:
                parts.append(self._session.run(None, dict(zip(GRAPH_INPUTS, inputs, strict=True))))
            except Exception as error:  # ONNX Runtime's classes have no common base
                raise cannot_run(self._source, error, EXPORT_AGAIN) from error
        if len(parts) == 1:
            return LawOutput._make(parts[0])
        return LawOutput._make(np.concatenate(column) for column in zip(*parts, strict=True))

    def _require_answers(self) -> None:
        """A file that opens may still not run or take other inputs; an idle arm shows it."""
        arm = self.metadata.arm
        parameters = arm_parameters(arm)
        size = len(parameters)
        joints = arm.joint_count
        seen = self(
            np.full((1, arm.cable_count), arm.cables.pretension_n),
            np.zeros((1, joints)),
            parameters.prior_mean,
            np.diag(parameters.prior_std**2),
            np.zeros((joints, joints)),
        )
        shape = (1, arm.cable_count, size)
        finite = all(np.isfinite(part).all() for part in seen)
        if seen.by_parameter.shape != shape or not finite:
            raise ModelFileError(
                f"{self._source}: its answer for an idle arm is not finite, or not of "
                f"{size} parameters; make it again with `cablesense export`"
            )
