"""What a diagnosis fits beside effects: the uncertain parameters of an arm, as numbers of effects.

`cablesense_sim.tolerances.ArmParameters` lists what is uncertain about a built arm, with standard
deviations by the tolerances of the arm file. Here each of these parameters is the `Term` of an
effect that the simulator knows, so that a diagnosis can vary it and an arm file can list it.
Some have no term: the slides, which are a state; the coefficient of friction, which is an effect;
and centres of mass across their segments' axes, as the simulator's masses lie on these. Two kinds
of terms have no parameter: where loads were applied, which belongs to the recording, and each
cable's own share of the friction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.nuisance_posterior import NuisancePosterior
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.arm import Arm
from cablesense_sim.effects.effect import WHOLE_ARM
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.tolerances import ArmParameters
from cablesense_sim.uncertain_arm import arm_parameters

_NUMBERS = {
    "cable_stiffness": ("cable_tolerance", "log_stiffness"),
    "pretension": ("cable_tolerance", "pretension_n"),
    "sensor_gain": ("sensor_tolerance", "gain"),
    "sensor_zero": ("sensor_tolerance", "zero_n"),
    "segment_mass": ("segment_tolerance", "mass_share"),
    "centre_of_mass": ("segment_tolerance", "centre_m"),
    "segment_length": ("segment_tolerance", "length_m"),
}
"""Effect and parameter of the kinds whose places are those of the effect."""


@dataclass(frozen=True)
class FittedParameters:
    """What a recording says about an arm's uncertain parameters, in the order of `names`.

    Attributes:
        names: (P,) as `ArmParameters.names`.
        mean: (P,) most probable deviations from the file, in their units.
        covariance: (P, P) of them, beside the effects of the hypothesis.
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array


def terms_of(parameters: ArmParameters) -> list[Term | None]:
    """(P,) the term of each parameter, None where it has none."""
    return [_term(group.name, place) for group in parameters.groups for place in group.places]


def _term(kind: str, place: str) -> Term | None:
    if kind in _NUMBERS:
        effect, number = _NUMBERS[kind]
        return Term(effect, place, number)
    if kind.startswith("hole_"):
        _, way, plate = kind.split("_")
        cable = place.partition(" ")[0]
        return Term("hole_tolerance", f"{cable}_plate_{plate}", f"{way}_m")
    if kind == "base_tilt":
        return Term("base_tolerance", WHOLE_ARM, f"{place.replace(' ', '_')}_rad")
    if kind == "joint_zero":
        joint, _, axis = place.rpartition("_")
        return Term("joint_tolerance", joint, f"{axis}_rad")
    return None


def tolerance_candidates(arm: Arm) -> tuple[Candidate, ...]:
    """The tolerances of an arm; each parameter's `typical` is its standard deviation.

    Those of zero are left out.
    """
    parameters = arm_parameters(arm)
    std = {"contact_m": arm.tolerances.contact_m, "friction_share": arm.tolerances.friction_share}
    for term, deviation in zip(terms_of(parameters), parameters.prior_std, strict=True):
        if term is not None and deviation > 0.0:
            std[term.parameter] = float(deviation)
    candidates = []
    for effect in known_effects().values():
        numbers = [p for p in effect.parameters if std.get(p.name, 0.0) > 0.0]
        if effect.tolerance and numbers:
            places = effect.places(arm.segment_count, arm.cable_count)
            scattered = tuple(replace(p, typical=std[p.name]) for p in numbers)
            candidates.append(Candidate(effect.name, places, scattered))
    return tuple(candidates)


def fitted_parameters(nominal: Arm, amended: Arm, known: NuisancePosterior) -> FittedParameters:
    """Uncertain parameters of an arm after a diagnosis.

    What the tolerances say beyond the `nominal` arm adds to what its file lists of them. The
    coefficient of friction is that of the `amended` arm. Other parameters are as expected.
    """
    parameters = arm_parameters(amended)
    off: dict[Term, float] = dict(zip(known.terms, known.mean.tolist(), strict=True))
    for listed in nominal.effects:
        if known_effects()[listed.effect].tolerance:
            for name, value in listed.parameters.items():
                listed_term = Term(listed.effect, listed.at, name)
                off[listed_term] = off.get(listed_term, 0.0) + value
    mean = parameters.prior_mean.copy()
    covariance = np.diag(parameters.prior_std**2)
    fitted = {term: k for k, term in enumerate(known.terms)}
    positions = []
    columns = []
    for position, term in enumerate(terms_of(parameters)):
        if term is None:
            continue
        mean[position] += off.get(term, 0.0)
        if term in fitted:
            positions.append(position)
            columns.append(fitted[term])
    covariance[np.ix_(positions, positions)] = known.covariance[np.ix_(columns, columns)]
    return FittedParameters(tuple(parameters.names), mean, covariance)
