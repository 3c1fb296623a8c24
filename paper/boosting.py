"""Baselines without a network: gradient-boosted trees, one model for each quantity asked.

Trees split on one input at a time and answer in steps, so a force that is linear in twelve inputs
is the opposite of what suits them: a measure of what "any learner" reaches.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingClassifier, HistGradientBoostingRegressor

from cablesense_base import Array
from cablesense_contact.estimate import NORMAL_95
from cablesense_training.data.dataset import Dataset
from cablesense_training.evaluation.metrics import ContactAnswer, angle_difference_deg

_SEED = 0
_HELD_OUT = 0.1
"""The share of the samples that the stated deviations are taken from."""


@dataclass(frozen=True)
class BoostingSettings:
    """How the trees grow.

    Attributes:
        rounds: trees per model (per class for the contact).
        leaves: most leaves of a tree.
        pose_aware: whether the commanded joint angles join the tension differences as input.
    """

    rounds: int = 200
    leaves: int = 63
    pose_aware: bool = False

    @property
    def options(self) -> dict[str, Any]:
        """The options of scikit-learn's models of boosted trees."""
        return {
            "max_iter": self.rounds,
            "max_leaf_nodes": self.leaves,
            "learning_rate": 0.1,
            "early_stopping": False,
            "random_state": _SEED,
        }


class BoostingBaseline:
    """Single contacts: a classifier for the contact, regressors for direction and magnitude."""

    def __init__(self, dataset: Dataset, settings: BoostingSettings | None = None) -> None:
        """Fit to a single-contact dataset.

        Trees state no uncertainty; the stated deviations are those that hold 95 % of held-out
        errors.
        """
        settings = settings or BoostingSettings()
        self._pose_aware = settings.pose_aware
        order = np.random.default_rng(_SEED).permutation(len(dataset))
        held_out = max(1, round(_HELD_OUT * len(dataset)))
        validation = dataset.select(order[:held_out])
        training = dataset.select(order[held_out:])
        touched = training.segment > 0
        x = self._inputs(training)
        options = settings.options
        angle = np.deg2rad(training.angle_deg[touched])
        self._contact = HistGradientBoostingClassifier(**options).fit(x, training.segment)
        self._sine, self._cosine, self._magnitude = (
            HistGradientBoostingRegressor(**options).fit(x[touched], label)
            for label in (np.sin(angle), np.cos(angle), training.magnitude_n[touched])
        )
        self._magnitude_std_n = 1.0
        self._angle_std_deg = 1.0
        answer = self.answer(validation)
        hits = (validation.segment > 0) & (answer.segment > 0)
        if hits.any():
            force = np.abs(answer.magnitude_n - validation.magnitude_n)[hits]
            off_deg = np.abs(angle_difference_deg(answer.angle_deg, validation.angle_deg))[hits]
            self._magnitude_std_n = float(np.quantile(force, 0.95)) / NORMAL_95
            self._angle_std_deg = float(np.quantile(off_deg, 0.95)) / NORMAL_95

    def answer(self, dataset: Dataset) -> ContactAnswer:
        """Answers for a dataset; the stated deviations are the same for all samples."""
        x = self._inputs(dataset)
        angle = np.rad2deg(np.arctan2(self._sine.predict(x), self._cosine.predict(x)))
        return ContactAnswer(
            segment=np.asarray(self._contact.predict(x), dtype=np.int64),
            angle_deg=angle % 360.0,
            magnitude_n=np.maximum(self._magnitude.predict(x), 0.0),
            magnitude_std_n=np.full(len(dataset), self._magnitude_std_n),
            angle_std_deg=np.full(len(dataset), self._angle_std_deg),
        )

    def _inputs(self, dataset: Dataset) -> Array:
        if self._pose_aware:
            return np.hstack([dataset.tension_difference_n, dataset.command_rad])
        return dataset.tension_difference_n


class MultiBoostingBaseline:
    """A classifier and a regressor for each segment, from the tension differences alone."""

    def __init__(self, dataset: Dataset, settings: BoostingSettings | None = None) -> None:
        """Fit to a multi-contact dataset."""
        options = (settings or BoostingSettings()).options
        self._contacts = []
        self._forces = []
        x = dataset.tension_difference_n
        for touched, force in zip(dataset.contacts.T, dataset.magnitudes_n.T, strict=True):
            self._contacts.append(HistGradientBoostingClassifier(**options).fit(x, touched))
            self._forces.append(
                HistGradientBoostingRegressor(**options).fit(x[touched], force[touched])
            )

    def answer(self, dataset: Dataset) -> tuple[NDArray[np.bool_], Array]:
        """Which segments are touched (B, N), and with which force (B, N)."""
        x = dataset.tension_difference_n
        touched = np.stack([np.asarray(c.predict(x), dtype=bool) for c in self._contacts], axis=1)
        force = np.stack([np.asarray(f.predict(x)) for f in self._forces], axis=1)
        return touched, np.maximum(force, 0.0)
