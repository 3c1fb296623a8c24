"""What a network is trained on: a dataset file, or fresh samples of the protocol that suits it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cablesense_sim.arm import Arm
from cablesense_training.data import Dataset, generate, protocol_from_options, read_dataset
from cablesense_training.data.progress import sample_progress


def protocol_kind(network_name: str) -> str:
    """Kind of the protocol that a network learns from."""
    return "multi" if network_name.startswith("multi-contact") else "single"


def read_samples(path: Path, arm: Arm) -> Dataset:
    """A dataset file of that arm.

    Raises:
        DatasetError: not a dataset, or one of another arm.
    """
    return read_dataset(path, arm)


def draw_samples(
    arm: Arm,
    network_name: str,
    options: dict[str, Any],
    seed: int,
    *,
    workers: int = 1,
    show_progress: bool = False,
) -> Dataset:
    """Fresh samples for a network; `options` are the protocol's, None standing for its default.

    Raises:
        DatasetError: an option out of range.
    """
    given = {name: value for name, value in options.items() if value is not None}
    protocol = protocol_from_options({"kind": protocol_kind(network_name), **given})
    parts = []
    with sample_progress(protocol.samples, shown=show_progress) as advance:
        for part in generate(arm, protocol, seed, workers=workers):
            parts.append(part)
            advance(len(part))
    return Dataset.concatenate(parts)
