"""The gradient-boosting peer for several contacts: trees per segment for touch and force."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingClassifier, HistGradientBoostingRegressor

from cablesense_training.data.dataset import Dataset
from cablesense_training.errors import TrainingError
from cablesense_training.peers.boosting import BoostingSettings

Array = NDArray[np.float64]


class MultiBoostingPeer:
    """A classifier and a regressor for each segment, from the tension differences alone."""

    def __init__(self, dataset: Dataset, settings: BoostingSettings | None = None) -> None:
        """Fit to a multi-contact dataset.

        Raises:
            TrainingError: a segment that is always, or never, touched.
        """
        settings = settings or BoostingSettings()
        options = {
            "max_iter": settings.rounds,
            "max_leaf_nodes": settings.leaves,
            "learning_rate": settings.learning_rate,
            "early_stopping": False,
            "random_state": settings.seed,
        }
        self._contacts, self._forces = [], []
        for segment, touched in enumerate(dataset.contacts.T):
            if touched.all() or not touched.any():
                raise TrainingError(
                    f"segment {segment + 1} is touched in {int(touched.sum())} of {len(dataset)} "
                    "samples; give samples with and without a contact on every segment"
                )
            x, force = dataset.tension_difference_n, dataset.magnitudes_n[:, segment]
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
