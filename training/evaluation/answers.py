"""Answers of a trained network on a dataset, as the metrics take them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cablesense_training.data.dataset import Dataset
from cablesense_training.evaluation.metrics import ContactAnswer
from cablesense_training.networks import MultiContactNetwork, Network, SingleContactNetwork

_ROWS_AT_ONCE = 8192


def single_contact_answer(network: SingleContactNetwork, dataset: Dataset) -> ContactAnswer:
    """Answers of a single-contact network on a dataset; angles in [0, 360)."""
    outputs = list(_outputs(network, dataset))
    logits, direction, magnitude, magnitude_std, angle_std = (
        torch.cat(parts).double().numpy() for parts in zip(*outputs, strict=True)
    )
    return ContactAnswer(
        segment=logits.argmax(axis=1),
        angle_deg=np.rad2deg(np.arctan2(direction[:, 0], direction[:, 1])) % 360.0,
        magnitude_n=magnitude,
        magnitude_std_n=magnitude_std,
        angle_std_deg=angle_std,
    )


def multi_contact_answer(
    network: MultiContactNetwork, dataset: Dataset
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Touched segments (B, N) and magnitudes (B, N) of a multi-contact network on a dataset."""
    logits, magnitude, _ = zip(*_outputs(network, dataset), strict=True)
    touched: NDArray[np.bool_] = torch.cat(logits).numpy() > 0.0
    return touched, torch.cat(magnitude).double().numpy()


def _outputs(network: Network, dataset: Dataset) -> Iterator[tuple[Tensor, ...]]:
    dtype = next(network.parameters()).dtype
    tension = torch.as_tensor(dataset.tension_difference_n).to(dtype)
    command = torch.as_tensor(dataset.command_rad).to(dtype)
    network.eval()
    with torch.no_grad():
        for start in range(0, len(tension), _ROWS_AT_ONCE):
            rows = slice(start, start + _ROWS_AT_ONCE)
            yield tuple(network(tension[rows], command[rows]))
