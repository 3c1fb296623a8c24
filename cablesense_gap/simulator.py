"""All that the diagnosis knows of a mechanism: sensor channels under named parameters.

Bring another mechanism by giving an object with the attributes and the one method of `Simulator`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from cablesense_base import Array
from cablesense_sim.effects.effect import Parameter


class Term(NamedTuple):
    """One number of one effect in one place."""

    effect: str
    place: str
    parameter: str

    def __str__(self) -> str:
        """Effect, place and parameter with dots between, such as `sensor_gain.cable_3.gain`."""
        return f"{self.effect}.{self.place}.{self.parameter}"


Assignment = Mapping[Term, float]
"""Values of the effects that are present; with none, the mechanism is nominal."""


@dataclass(frozen=True)
class Candidate:
    """An effect that may be the cause.

    Attributes:
        places: where it can sit; `arm` for everywhere at once.
        parameters: its numbers in each place.
        richer: further numbers, of forms that are tried once the plain one is found.
        history_dependent: whether readings then depend on the past: expensive to simulate.
        against_motion: whether it turns round with the motion, as friction does, so that nothing
            static imitates it.
    """

    effect: str
    places: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    history_dependent: bool = False
    against_motion: bool = False
    richer: tuple[Parameter, ...] = ()

    def terms(self, place: str) -> tuple[Term, ...]:
        """Its numbers in one place."""
        return tuple(Term(self.effect, place, p.name) for p in self.parameters)


def parameters_of(candidates: Sequence[Candidate]) -> dict[Term, Parameter]:
    """Every number of the candidates in every place, with its unit and range."""
    return {
        Term(candidate.effect, place, parameter.name): parameter
        for candidate in candidates
        for place in candidate.places
        for parameter in (*candidate.parameters, *candidate.richer)
    }


class Simulator(Protocol):
    """A mechanism under the commands and loads of one recording.

    It is pickled where several processes share the search.

    Attributes:
        candidates: effects to choose among.
        tolerances: manufacturing tolerances; each parameter's `typical` is its standard deviation.
        floor: root mean square of what the sensors add to a perfect reading. Channels share one
            unit; those of different kinds are given in units of their noise, with a floor of 1.
    """

    @property
    def candidates(self) -> Sequence[Candidate]: ...  # noqa: D102

    @property
    def tolerances(self) -> Sequence[Candidate]: ...  # noqa: D102

    @property
    def floor(self) -> float: ...  # noqa: D102

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Channels (P, R, C) of P variants, all with the same terms, without noise.

        NaN where the mechanism cannot be simulated with these numbers.
        """
        ...


@runtime_checkable
class LinearSimulator(Simulator, Protocol):
    """A `Simulator` that knows its derivatives: faster where there are many tolerances."""

    def small_changes(self, base: Assignment, variants: Sequence[Assignment]) -> Array:
        """Changes (P, R, C) of the channels by small differences from a base, to first order."""
        ...


def small_changes(simulator: Simulator, base: Assignment, variants: Sequence[Assignment]) -> Array:
    """Changes (P, R, C) of the channels by small differences of variants from a base."""
    if isinstance(simulator, LinearSimulator):
        return simulator.small_changes(base, variants)
    return predicted_changes(simulator, base, variants)


def predicted_changes(
    simulator: Simulator, base: Assignment, variants: Sequence[Assignment]
) -> Array:
    """Changes (P, R, C) of the channels from a base, as predicted."""
    about, *moved = simulator.predict([base, *variants])
    return np.array(moved).reshape(len(moved), *about.shape) - about
