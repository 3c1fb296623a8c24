"""The points of a dataset in the unit cube: a scrambled Sobol sequence, addressed by chunk.

A grid covers a space exhaustively, but its size is a product of resolutions that somebody has to
choose, and a random draw of the same size leaves holes. A Sobol sequence covers evenly at any
number of points (every dyadic box of volume 2^-m holds its share of each aligned block of 2^m
points) and has no resolution to choose, so 5,000 samples and 5,000,000 come from one rule.
Scrambling makes different seeds independent of each other.

Work is cut into chunks of `CHUNK_SAMPLES`, whatever the number of workers. A chunk's points and
its random stream follow from the seed and the chunk's number alone; that is why one worker and
twenty write the same bytes.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

CHUNK_SAMPLES = 2048
"""A power of two, so that every chunk is a balanced block of the sequence."""

MAX_SAMPLES = 2**30
"""The length of the sequence."""

_DESIGN, _NOISE, _REDRAW, _ARM = 0, 1, 2, 3


def unit_points(dimensions: int, seed: int, chunk: int) -> NDArray[np.float64]:
    """Points (CHUNK_SAMPLES, dimensions) in [0, 1) of the given chunk of the seed's sequence."""
    scramble = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_DESIGN,)))
    sequence = qmc.Sobol(dimensions, scramble=True, rng=scramble)
    if chunk:
        sequence.fast_forward(chunk * CHUNK_SAMPLES)
    return np.asarray(sequence.random(CHUNK_SAMPLES))


def noise_stream(seed: int, chunk: int) -> np.random.Generator:
    """The random stream of a chunk's sensor noise, independent of the points."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_NOISE, chunk)))


def redraw_stream(seed: int, chunk: int) -> np.random.Generator:
    """The random stream that replaces a chunk's points beyond the arm."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_REDRAW, chunk)))


def arm_stream(seed: int, chunk: int, block: int) -> np.random.Generator:
    """The random stream of the arm that a block of a chunk is drawn on, and of its course."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_ARM, chunk, block)))


def chunk_sizes(samples: int) -> list[int]:
    """How many samples each chunk contributes: full chunks, then what is left."""
    full, rest = divmod(samples, CHUNK_SAMPLES)
    return [CHUNK_SAMPLES] * full + ([rest] if rest else [])
