"""Writes the estimator of an arm as one ONNX file: no training, some seconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from cablesense_base import Array
from cablesense_base.files import write_atomically
from cablesense_base.installation import package_version
from cablesense_contact.inference.metadata import ANYWHERE, ModelMetadata, effect_versions
from cablesense_contact.inference.session import open_session
from cablesense_contact.law import GRAPH_INPUTS, LawOutput
from cablesense_sim.arm import Arm
from cablesense_sim.uncertain_arm import arm_parameters
from cablesense_training.errors import TrainingError
from cablesense_training.evaluation.law import law_protocol
from cablesense_training.evaluation.touches import drawn_touches, settled_readings_n
from cablesense_training.export import TRACED_ROWS, to_onnx
from cablesense_training.law.build import TorchLaw
from cablesense_training.law.posterior import LARGEST_N
from cablesense_training.law_check import require_sound

_AGREEMENT = 1e-6
"""Largest difference allowed between PyTorch and ONNX Runtime, as a share of the largest."""
_INTERVALS = ("place_ci95_m", "region_m", "magnitude_ci95_n")
_INTERVAL_AGREEMENT = 1e-5
"""Of their ends, whose distributions are in single precision (see `law.statement`), or"""
_SHARE_OF_WIDTH = 1e-3
"""this share of an interval's width, if that is more: where readings say next to nothing, an end
is where a flat distribution reaches a value."""

_TRIAL_ROWS = 16
"""On which an exported law is compared with the original, of"""
_DRAWN_ROWS = 64
"""that are drawn: an arm may find no rest under some."""
_COMMANDED_DEG = 20.0
"""Largest joint angle that a model file states."""


def export_law(arm: Arm, path: Path, command: str, unexplained_n2: Array | None = None) -> None:
    """Write the estimator of an arm as a model file that answers as PyTorch does, checked.

    `command` is what makes the file again, kept in it. `unexplained_n2` (M, M) is the
    covariance of readings, N², by what the arm file does not know of the arm: with any, few
    contacts may be vouched for.

    Raises:
        TrainingError: the law does not hold on the arm's own statics (`require_sound`), PyTorch
            and ONNX Runtime differ, or the file cannot be written.
        WeakArmError: the arm cannot stand, or bears no contact.
    """
    law = TorchLaw(arm, unexplained_n2)
    if unexplained_n2 is not None and unexplained_n2.any():
        left_n = float(np.sqrt(np.diag(unexplained_n2).mean()))
        remedy = f"readings at rest are off by {left_n:.3g} N (RMS): first find what else acts"
        require_sound(law, arm, 0.0, remedy)
    else:
        require_sound(law, arm)
    estimator = law.estimator
    trial = _trial(arm)
    model = _to_onnx(estimator, trial)
    onnx.helper.set_model_props(model, _metadata(arm, command).to_properties())
    onnx.checker.check_model(model, full_check=False)
    _require_agreement(estimator, model, trial)
    write_atomically(path, model.SerializeToString(), TrainingError)


def _trial(arm: Arm) -> list[Tensor]:
    """Inputs of some rows: readings of the arm of the file, pushed in poses that it bears."""
    parameters = arm_parameters(arm)
    touches = drawn_touches(arm, law_protocol(arm, _DRAWN_ROWS), seed=0)
    readings_n = settled_readings_n(arm, touches, np.random.default_rng(0))
    rests = np.flatnonzero(np.isfinite(readings_n).all(axis=1))[:_TRIAL_ROWS]
    inputs = [
        readings_n[rests],
        touches.command_rad[rests],
        parameters.prior_mean,
        np.diag(parameters.prior_std**2),
        np.zeros((arm.joint_count, arm.joint_count)),
    ]
    return [torch.as_tensor(values) for values in inputs]


def _to_onnx(estimator: nn.Module, trial: list[Tensor]) -> onnx.ModelProto:
    readings, commands, *known = trial
    rows = torch.arange(TRACED_ROWS) % len(readings)
    traced = (readings[rows], commands[rows], *known)
    return to_onnx(estimator, dict(zip(GRAPH_INPUTS, traced, strict=True)), LawOutput._fields)


def _metadata(arm: Arm, command: str) -> ModelMetadata:
    return ModelMetadata(
        kind=ANYWHERE,
        network="anywhere",
        arm=arm,
        arm_identity=arm.identity,
        cable_names=arm.cable_names,
        joint_names=arm.joint_names,
        pose_aware=True,
        pose_range_deg=_COMMANDED_DEG,
        force_range_n=LARGEST_N,
        tare_samples=1,
        effect_versions=effect_versions(arm),
        command=command,
        seed=0,
        version=package_version(),
    )


def _require_agreement(estimator: nn.Module, model: onnx.ModelProto, trial: list[Tensor]) -> None:
    session = open_session(model)
    inputs = {name: value.numpy() for name, value in zip(GRAPH_INPUTS, trial, strict=True)}
    by_runtime = session.run(None, inputs)
    with torch.no_grad():
        by_torch = estimator(*trial)
    for name, computed, expected in zip(LawOutput._fields, by_runtime, by_torch, strict=True):
        require_agreement(name, computed, expected.numpy())


def require_agreement(name: str, computed: Array, expected: Array) -> None:
    """Compare an output of ONNX Runtime with PyTorch's.

    Raises:
        TrainingError: it is not finite, or they differ by more than rounding.
    """
    if not np.isfinite(computed).all():
        raise TrainingError(f"output {name} is not finite in ONNX Runtime")
    scale = max(1.0, float(np.abs(computed).max()))
    allowed = np.full_like(expected, _AGREEMENT * scale)
    if name in _INTERVALS:
        width = np.ptp(expected, axis=-1, keepdims=True)
        allowed[:] = np.maximum(_INTERVAL_AGREEMENT * scale, _SHARE_OF_WIDTH * width)
    difference = np.abs(computed - expected)
    worst = int((difference - allowed).argmax())
    if not difference.flat[worst] <= allowed.flat[worst]:
        raise TrainingError(
            f"output {name} differs by {difference.flat[worst]:.2g} between PyTorch and ONNX "
            f"Runtime; at most {allowed.flat[worst]:.2g} is allowed"
        )
