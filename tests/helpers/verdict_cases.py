"""Verdicts for tests: one line says what is of interest, the rest is plausible."""

from typing import Any

from cablesense_gap.verdict import CandidateResult, Gap, Verdict, Where, removed_fraction


def gap_of(before_n: float, after_n: float, floor_n: float = 0.1) -> Gap:
    removed = removed_fraction(before_n, after_n, floor_n)
    return Gap(
        before_n=before_n,
        after_n=after_n,
        floor_n=floor_n,
        removed_fraction=removed,
        ci95=(removed - 0.05, removed),
        by_cable_n=(before_n,) * 12,
    )


def verdict_of(
    effects: str,
    probability: float = 0.9,
    *,
    others: dict[str, float] | None = None,
    cables: tuple[str, ...] = (),
    segments: tuple[str, ...] = (),
    joints: tuple[str, ...] = (),
    gap: Gap | None = None,
    **more: Any,
) -> Verdict:
    """A verdict on `a+b`; `others` are further candidates with their probabilities."""
    weighed = {effects: probability, **(others or {})}
    return Verdict(
        effects=tuple(effects.split("+")),
        probability=probability,
        where=Where(cables=cables, segments=segments, joints=joints),
        gap=gap or gap_of(3.0, 0.2),
        candidates=tuple(
            CandidateResult(effects=tuple(name.split("+")), held_out_rmse_n=1.0, probability=p)
            for name, p in weighed.items()
        ),
        **more,
    )
