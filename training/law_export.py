"""Writes the estimator of an arm as one ONNX file: no training, some seconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from cablesense_base.files import write_atomically
from cablesense_base.installation import package_version
from cablesense_contact.inference.metadata import ANYWHERE, ModelMetadata, effect_versions
from cablesense_contact.inference.session import open_session
from cablesense_contact.law import INPUTS, LawOutput
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.replay import read_tensions_n
from cablesense_sim.uncertain_arm import arm_parameters
from cablesense_training.errors import TrainingError
from cablesense_training.export import TRACED_ROWS, to_onnx
from cablesense_training.law.build import arm_estimator
from cablesense_training.law.posterior import LARGEST_N

AGREEMENT = 1e-6
"""Largest difference allowed between PyTorch and ONNX Runtime, as a share of the largest."""

_TRIAL_ROWS = 16
"""On which an exported law is compared with the original."""
_COMMANDED_DEG = 20.0
"""Largest joint angle of these."""
_PUSH_N = 10.0
"""Deviation of each component of their forces."""


def export_law(arm: Arm, path: Path, command: str, unexplained_n2: float = 0.0) -> None:
    """Write the estimator of an arm as a model file that answers as PyTorch does, checked.

    `command` is what makes the file again, kept in it. `unexplained_n2` is the variance of
    readings, N², by what the arm file does not know of the arm.

    Raises:
        TrainingError: PyTorch and ONNX Runtime differ, or the file cannot be written.
    """
    estimator = arm_estimator(arm, unexplained_n2).double().eval()
    trial = _trial(arm)
    model = _to_onnx(estimator, trial)
    onnx.helper.set_model_props(model, _metadata(arm, command).to_properties())
    onnx.checker.check_model(model, full_check=False)
    _require_agreement(estimator, model, trial)
    write_atomically(path, model.SerializeToString(), TrainingError)


def _trial(arm: Arm) -> list[Tensor]:
    """Inputs of some rows: readings of the arm of the file, pushed in usual poses."""
    rng = np.random.default_rng(0)
    parameters = arm_parameters(arm)
    reach = np.deg2rad(_COMMANDED_DEG)
    joints = arm.joint_count
    commands = rng.uniform(-reach, reach, (_TRIAL_ROWS, joints))
    forces_n = np.zeros((_TRIAL_ROWS, arm.segment_count, 3))
    rows = np.arange(_TRIAL_ROWS)
    pushed = rng.integers(0, arm.segment_count, _TRIAL_ROWS)
    forces_n[rows, pushed] = rng.normal(0.0, _PUSH_N, (_TRIAL_ROWS, 3))
    rest = solve_equilibrium(mechanism_of(arm), commands, forces_n)
    inputs = [
        read_tensions_n(rest.tensions_n, arm.sensors, rng),
        commands,
        parameters.prior_mean,
        np.diag(parameters.prior_std**2),
        np.zeros((joints, joints)),
    ]
    return [torch.as_tensor(values) for values in inputs]


def _to_onnx(estimator: nn.Module, trial: list[Tensor]) -> onnx.ModelProto:
    rows = torch.arange(TRACED_ROWS) % _TRIAL_ROWS
    readings, commands, *known = trial
    traced = (readings[rows], commands[rows], *known)
    return to_onnx(estimator, dict(zip(INPUTS, traced, strict=True)), LawOutput._fields)


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
    inputs = {name: value.numpy() for name, value in zip(INPUTS, trial, strict=True)}
    by_runtime = session.run(None, inputs)
    with torch.no_grad():
        by_torch = estimator(*trial)
    for name, computed, expected in zip(LawOutput._fields, by_runtime, by_torch, strict=True):
        if not np.isfinite(computed).all():
            raise TrainingError(f"output {name} is not finite in ONNX Runtime")
        scale = max(1.0, float(np.abs(computed).max()))
        difference = float(np.abs(computed - expected.numpy()).max()) / scale
        if not difference <= AGREEMENT:
            raise TrainingError(
                f"output {name} differs by {difference:.2g} between PyTorch and ONNX Runtime; at "
                f"most {AGREEMENT:g} is allowed"
            )
