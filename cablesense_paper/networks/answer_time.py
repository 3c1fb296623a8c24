"""How long a network takes for one answer."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from cablesense_paper.networks.building import build
from cablesense_paper.networks.shapes import Shape
from cablesense_sim.arm import Arm
from cablesense_training.export import export_model
from cablesense_training.inference.metadata import ModelMetadata
from cablesense_training.inference.session import TENSION, open_session, read_model

_BLOCKS, _RUNS = 7, 300


def answer_us(shape: Shape, arm: Arm) -> float:
    """Microseconds that ONNX Runtime takes for one answer on one core: the best of some blocks.

    What a network has learnt does not change how long it takes, so an untrained one is timed.
    """
    metadata = ModelMetadata(
        kind="single-contact",
        network=shape.architecture,
        arm=arm,
        arm_identity=arm.identity,
        cable_names=arm.cable_names,
        joint_names=arm.joint_names,
        pose_aware=False,
        pose_range_deg=0.0,
        force_range_n=200.0,
        tare_samples=1,
        command="",
        seed=0,
        version="",
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "shape.onnx")
        export_model(build(shape, arm, 0), path, metadata)
        model, _ = read_model(path)
    session = open_session(model)
    inputs = {TENSION: np.linspace(-20.0, 30.0, arm.cable_count)[None]}
    took = []
    for _ in range(_BLOCKS):
        began = time.perf_counter()
        for _ in range(_RUNS):
            session.run(None, inputs)
        took.append((time.perf_counter() - began) / _RUNS)
    return 1e6 * min(took)
