"""Second thoughts on where a fitted hypothesis has its effects."""

from __future__ import annotations

from collections.abc import Iterator

from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.hypothesis import Hypothesis
from cablesense_gap.diagnosis.looking import Look, Offered, single_looks
from cablesense_gap.diagnosis.placing import WORTH
from cablesense_gap.diagnosis.refitting import refit
from cablesense_gap.diagnosis.starting import fit

_ROUNDS = 2
_STEPS = 4


def rethink(course: Course, hypothesis: Hypothesis, offered: Offered) -> Hypothesis:
    """The hypothesis with each of two effects looked at again beside the other as it is fitted.

    The places were chosen linear about the nominal mechanism, and beside effects that were not
    there yet. Of equal hypotheses the one with fewer places is given.
    """
    for _ in range(_ROUNDS):
        better = hypothesis
        for look in _again(course, hypothesis, offered):
            fitted = fit(course, look)
            if fitted is not None and course.cost_of(fitted) < course.cost_of(better):
                better = fitted
        if better is hypothesis:
            break
        hypothesis = better
    return _fewest(course, hypothesis)


def singled_out(course: Course, hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    """Each of two effects alone, begun with its numbers beside the other.

    A search for one effect may end early where a second one then makes up for it.
    """
    if len(hypothesis.effects) < 2:
        return
    for effect in hypothesis.effects:
        own = {t: v for t, v in hypothesis.values.items() if t.effect == effect}
        fitted = refit(course, own, _STEPS)
        if fitted is not None:
            yield fitted


def _again(course: Course, hypothesis: Hypothesis, offered: Offered) -> Iterator[Look]:
    if len(hypothesis.effects) < 2:
        return
    for effect in hypothesis.effects:
        others = {t: v for t, v in hypothesis.values.items() if t.effect != effect}
        beside = refit(course, others, 0)
        if beside is None or effect not in offered:
            continue
        for look in single_looks(course, {effect: offered[effect]}, beside):
            placed = {block.place for block in look.placed.blocks}
            if placed != {t.place for t in hypothesis.values if t.effect == effect}:
                yield look


def _fewest(course: Course, hypothesis: Hypothesis) -> Hypothesis:
    """Places are left out as long as what is left hardly grows."""
    sites = list(dict.fromkeys((term.effect, term.place) for term in hypothesis.values))
    cost = course.cost_of(hypothesis)
    for effect, place in reversed(sites):
        if sum(e == effect for e, _ in sites) == 1:
            continue
        rest = {t: v for t, v in hypothesis.values.items() if t[:2] != (effect, place)}
        fitted = refit(course, rest, _STEPS)
        if fitted is None or course.cost_of(fitted) > WORTH * cost:
            continue
        hypothesis = fitted
        sites.remove((effect, place))
    return hypothesis
