"""The type of an array of numbers; docstrings say shapes and units."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
