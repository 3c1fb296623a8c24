"""Section III-C: networks of many shapes are tried as planned."""

import pytest

from paper.studies import networks

PLAN = networks.Plan(
    depths=(1, 2),
    widths=(4, 8),
    compared_depth=2,
    seeds=(0, 3),
    samples=128,
    batch_size=64,
    epochs=1,
    test_samples=64,
    paper_poses=("straight", "random"),
    workers=1,
)


@pytest.mark.slow
def test_every_shape_is_tried_with_every_seed_and_one_learns_from_little_data(monkeypatch):
    monkeypatch.setattr(networks, "PAPER_SAMPLES", 128)
    shares = []
    results = networks.explore(PLAN, shares.append)
    tried = [*zip(results.trials.index, results.trials["seed"], strict=True)]
    assert tried == [(shape, seed) for shape in PLAN.shapes for seed in PLAN.seeds]
    assert shares == sorted(shares)
    assert tuple(results.with_little_data) == PLAN.paper_poses
    for one in results.with_little_data.values():
        assert one.items() >= networks.PAPER_SHAPE._asdict().items()
