"""Uncertain parameters of one kind at many places, laid out one kind after another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from cablesense_base import Array

CARRIED_FRICTION = "carried_friction"
"""Name of the parameters that are the state of friction, followed by the number of a guide."""


@dataclass(frozen=True)
class ParameterGroup:
    """Parameters of one kind, one at each of its places.

    Attributes:
        name: of the kind, for example `cable_stiffness`.
        unit: of a deviation; `1` for shares.
        places: for example `cable_3`, or `cable_3 at plate 2`.
        std: one standard deviation by the tolerances.
        mean: the deviation to be expected; zero but for friction.
    """

    name: str
    unit: str
    places: tuple[str, ...]
    std: float
    mean: float = 0.0


class GroupedParameters:
    """P uncertain parameters θ, as one vector of deviations from a description.

    Attributes:
        groups: their kinds, in the order of the vector.
    """

    def __init__(self, groups: tuple[ParameterGroup, ...]) -> None:
        self.groups = groups

    def __len__(self) -> int:
        return sum(len(group.places) for group in self.groups)

    @property
    def names(self) -> list[str]:
        """(P,) the kind and place of each, for example `cable_stiffness of cable_3`."""
        return [f"{group.name} of {place}" for group in self.groups for place in group.places]

    @property
    def units(self) -> list[str]:
        """Unit of each of the P parameters."""
        return [group.unit for group in self.groups for _ in group.places]

    @property
    def prior_mean(self) -> Array:
        """(P,) deviations to be expected from the description alone."""
        return np.concatenate([np.full(len(g.places), g.mean) for g in self.groups])

    @property
    def prior_std(self) -> Array:
        """(P,) standard deviations by the tolerances."""
        return np.concatenate([np.full(len(g.places), g.std) for g in self.groups])

    @property
    def slices(self) -> Mapping[str, slice]:
        """Where the parameters of each kind stand."""
        return dict(self._slices())

    @property
    def carried_friction(self) -> slice:
        """Where the carried frictions stand, of all cables at one guide after another."""
        parts = [part for name, part in self._slices() if name.startswith(CARRIED_FRICTION)]
        if not parts:
            return slice(len(self), len(self))
        return slice(parts[0].start, parts[-1].stop)

    def drawn(self, rng: np.random.Generator) -> Array:
        """Deviations (P,) of a machine of these tolerances."""
        return self.prior_mean + self.prior_std * rng.standard_normal(len(self))

    def _slices(self) -> Iterator[tuple[str, slice]]:
        begin = 0
        for group in self.groups:
            end = begin + len(group.places)
            yield group.name, slice(begin, end)
            begin = end
