"""One recording of an arm, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """What was commanded, what pushed the arm, and what its sensors read: R rows in time order.

    Attributes:
        name: of the file it came from, without its suffix.
        time_s: (R,) since the recording began.
        trial: (R,) blocks that belong together; they are held out whole.
        command_rad: (R, 2N) commanded joint angles, pitch then yaw of each joint, base first.
        load_segment: (R,) 1 to N where a known load acts at the nominal contact point, else 0.
        load_n: (R, 3) that load, base frame.
        tensions_n: (R, M) as the sensors at the actuator ends read them.
    """

    name: str
    time_s: Array
    trial: NDArray[np.int64]
    command_rad: Array
    load_segment: NDArray[np.int64]
    load_n: Array
    tensions_n: Array

    def __len__(self) -> int:
        """Number of rows R."""
        return len(self.time_s)

    @property
    def forces_n(self) -> Array:
        """(R, N, 3) the load as one base-frame force per segment."""
        segments = np.arange(1, self.command_rad.shape[1] // 2 + 1)
        loaded = self.load_segment[:, None] == segments
        return loaded[..., None] * self.load_n[:, None, :]

    def rows(self, chosen: NDArray[Any] | slice) -> Recording:
        """The chosen rows: a mask (R,), indices or a slice."""
        return replace(
            self,
            time_s=self.time_s[chosen],
            trial=self.trial[chosen],
            command_rad=self.command_rad[chosen],
            load_segment=self.load_segment[chosen],
            load_n=self.load_n[chosen],
            tensions_n=self.tensions_n[chosen],
        )
