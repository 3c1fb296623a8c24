"""Tails of the chi-squared distribution, in closed form for whole degrees of freedom.

With h = x / 2 the probability that χ² of k degrees of freedom is above x is

    k even:  exp(-h) Σ_{j=0}^{k/2-1} h^j / j!
    k odd:   erfc(√h) + exp(-h) Σ_{j=1}^{(k-1)/2} h^{j-1/2} / Γ(j + 1/2)

(Abramowitz and Stegun, 26.4.4 and 26.4.5). All terms are positive, so nothing cancels. A robot's
computer thus needs no SciPy for the two numbers that it asks for.
"""

from __future__ import annotations

import math

_HALVINGS = 200
"""Of the interval in which a limit is sought; fewer would do for a double."""


def probability_above(value: float, freedom: int) -> float:
    """Probability that chi-squared of `freedom` degrees of freedom exceeds `value`.

    NaN for a value that is NaN, and without any degree of freedom.
    """
    if freedom < 1 or math.isnan(value):
        return math.nan
    half = value / 2.0
    if half <= 0.0:
        return 1.0
    if math.isinf(half):
        return 0.0
    log_half = math.log(half)
    odd = freedom % 2 == 1
    first = math.erfc(math.sqrt(half)) if odd else 0.0
    least_power = 0.5 if odd else 0.0
    powers = [least_power + j for j in range(freedom // 2)]
    terms = [math.exp(power * log_half - half - math.lgamma(power + 1.0)) for power in powers]
    return min(1.0, first + math.fsum(terms))


def limit_at(probability: float, freedom: int) -> float:
    """The value that chi-squared exceeds with a probability between 0 and 1.

    NaN without any degree of freedom.
    """
    if freedom < 1:
        return math.nan
    low = 0.0
    high = float(freedom)
    while probability_above(high, freedom) > probability:
        low = high
        high *= 2.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if probability_above(middle, freedom) > probability:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
