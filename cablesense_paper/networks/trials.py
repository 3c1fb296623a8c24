"""Shapes trained on the same samples, tested on the same others."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

from cablesense_paper.networks.building import build, parameters
from cablesense_paper.networks.shapes import Shape
from cablesense_training.data.dataset import Dataset
from cablesense_training.evaluation.answers import single_contact_answer, single_contact_truth
from cablesense_training.evaluation.metrics import single_contact_metrics
from cablesense_training.fit import FitSettings, fit


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
