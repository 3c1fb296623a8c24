"""A model opened: its file checked, tried on idle arms, and run for any number of samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
import onnxruntime
from onnx import ModelProto

from cablesense_base import Array
from cablesense_contact.errors import ModelFileError
from cablesense_contact.inference.metadata import MULTI_CONTACT, ModelMetadata
from cablesense_contact.inference.model_file import one_line, read_model, require_bounded
from cablesense_sim.arm import Arm

EXPORT_AGAIN = "make it again with `cablesense export`"
"""What to do about a model file of contacts anywhere that cannot be used."""
_ROWS_AT_ONCE = 2048
"""Samples that are answered together."""

TENSION = "tension_difference_n"
COMMAND = "joint_command_rad"


def input_widths(metadata: ModelMetadata) -> dict[str, int]:
    """The inputs of a model with these metadata, and the width of each."""
    widths = {TENSION: metadata.arm.cable_count}
    if metadata.pose_aware:
        widths[COMMAND] = metadata.arm.joint_count
    return widths


class OpenedModel:
    """A model whose file has been checked, and which has answered once; for one thread at a time.

    Attributes:
        metadata: what the file states about itself.
    """

    outputs: ClassVar[Sequence[str]]

    def __init__(self, path: str | Path, arm: Arm | None = None) -> None:
        self._source = str(path)
        model, self.metadata = read_model(path)
        made_for = self.metadata
        if arm is not None and not fits(made_for.arm, arm):
            raise ModelFileError(
                f"{path}: made for arm {made_for.arm_identity}, not for {arm.identity}; "
                "train one for this arm with `cablesense train --arm`"
            )
        outputs = [output.name for output in model.graph.output]
        if outputs != list(self.outputs):
            raise ModelFileError(
                f"{path}: a {made_for.kind} model that gives {', '.join(outputs)[:400]}; "
                f"needed are {', '.join(self.outputs)}"
            )
        try:
            require_bounded(model, self._source)
            self._session = open_session(model)
        except ModelFileError:
            raise
        except Exception as error:  # ONNX Runtime and onnx raise a family of their own each
            raise cannot_run(self._source, error, "train it again") from error
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

    def run(self, inputs: Mapping[str, Array]) -> list[Array]:
        """The model's `outputs` for the inputs that `input_widths` names, each (B, width).

        Raises:
            ModelFileError: ONNX Runtime cannot run it.
        """
        parts = []
        for start in range(0, len(inputs[TENSION]), _ROWS_AT_ONCE):
            rows = slice(start, start + _ROWS_AT_ONCE)
            part = {name: value[rows] for name, value in inputs.items()}
            try:
                parts.append(self._session.run(list(self.outputs), part))
            except Exception as error:  # ONNX Runtime's classes have no common base
                raise cannot_run(self._source, error, "train it again") from error
        if len(parts) == 1:
            return list(parts[0])
        return [np.concatenate(answers) for answers in zip(*parts, strict=True)]

    def _require_answers(self) -> None:
        """A file that opens may still not run or take other inputs; two idle arms show it."""
        segments = self.metadata.arm.segment_count
        shapes: dict[str, tuple[int, ...]] = {
            "contact_probability": (segments + 1,),
            "direction": (2,),
        }
        if self.metadata.kind == MULTI_CONTACT:
            shapes |= dict.fromkeys(self.outputs, (segments,))
        idle = {name: np.zeros((2, width)) for name, width in input_widths(self.metadata).items()}
        for name, answer in zip(self.outputs, self.run(idle), strict=True):
            shape = (2, *shapes.get(name, ()))
            fitting = answer.dtype == np.float64 and answer.shape == shape
            if not fitting or not np.isfinite(answer).all():
                raise ModelFileError(
                    f"{self._source}: gives {name} as {answer.dtype} of shape {answer.shape} for "
                    f"two idle arms, or not finite; needed are finite numbers, float64 of {shape}"
                )


def fits(made_for: Arm, arm: Arm) -> bool:
    """Whether a model's arm is an arm, but for its name and for effects that it lacks."""
    known = made_for.nominal.model_copy(update={"name": arm.name})
    lacks_some = all(effect in arm.effects for effect in made_for.effects)
    return known.identity == arm.nominal.identity and lacks_some


def cannot_run(source: str, error: Exception, remedy: str) -> ModelFileError:
    """The error of a graph from `source` that ONNX Runtime does not run, with what to do."""
    return ModelFileError(f"{source}: ONNX Runtime cannot run it ({one_line(error)}); {remedy}")


def open_session(model: ModelProto) -> onnxruntime.InferenceSession:
    """A session of a model, on one thread and silent."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    return onnxruntime.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
