"""Shapes trained on the same samples, tested on the same others, and timed."""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cablesense_paper.networks.shapes import Shape, build, parameters
from cablesense_sim.arm import Arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.evaluation.answers import single_contact_answer, single_contact_truth
from cablesense_training.evaluation.metrics import single_contact_metrics
from cablesense_training.export import export_model
from cablesense_training.fit import FitSettings, fit
from cablesense_training.inference.metadata import ModelMetadata
from cablesense_training.inference.session import TENSION, open_session, read_model

_BLOCKS, _RUNS = 7, 300


@dataclass(frozen=True)
class Trial:
    """One shape, trained with one seed.

    Attributes:
        shape: which.
        seed: of the initial weights, the split and the order of the batches.
        parameters: trained numbers behind the answers.
        wrong_contact: share of the test samples answered with a wrong class.
        direction_mae_deg, magnitude_mae_n, magnitude_rmse_n: on the test samples.
    """

    shape: Shape
    seed: int
    parameters: int
    wrong_contact: float
    direction_mae_deg: float
    magnitude_mae_n: float
    magnitude_rmse_n: float


def trial(
    shape: Shape, seed: int, training: Dataset, test: Dataset, settings: FitSettings
) -> Trial:
    """Train and test; on one thread, so that the same seed gives the same figures."""
    network = build(shape, training.arm, seed)
    fit(network, training, replace(settings, seed=seed, threads=1))
    answer = single_contact_answer(network.double(), test)
    truth = single_contact_truth(test)
    metrics = single_contact_metrics(truth, answer, test.arm.segment_count)
    return Trial(
        shape=shape,
        seed=seed,
        parameters=parameters(network),
        wrong_contact=1.0 - metrics.contact_accuracy,
        direction_mae_deg=metrics.errors.direction_mae_deg,
        magnitude_mae_n=metrics.errors.magnitude_mae_n,
        magnitude_rmse_n=metrics.errors.magnitude_rmse_n,
    )


def trials(
    cases: Sequence[tuple[Shape, int]],
    training: Dataset,
    test: Dataset,
    settings: FitSettings,
    workers: int,
) -> Iterator[Trial]:
    """A trial for every shape and seed, in order; the same for any number of workers."""
    if workers == 1:
        yield from (trial(shape, seed, training, test, settings) for shape, seed in cases)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        workers, context, initializer=_share, initargs=(training, test, settings)
    ) as pool:
        yield from pool.map(_shared_trial, cases)


_SHARED: dict[str, tuple[Dataset, Dataset, FitSettings]] = {}


def _share(training: Dataset, test: Dataset, settings: FitSettings) -> None:
    """Samples are sent to a worker once, not with every case."""
    _SHARED["samples"] = (training, test, settings)


def _shared_trial(case: tuple[Shape, int]) -> Trial:
    training, test, settings = _SHARED["samples"]
    return trial(*case, training, test, settings)


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
