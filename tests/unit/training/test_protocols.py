"""Protocols cover what they promise; effects are drawn in their ranges and places."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from cablesense_sim.effects.registry import known_effects
from cablesense_training.data.protocols import (
    CHUNK_SAMPLES,
    AnywhereContact,
    MultiContact,
    SingleContact,
    chunk_sizes,
    drawn_entries,
    effect_names,
    protocol_from_options,
    unit_points,
)
from cablesense_training.errors import DatasetError

SEGMENTS = 4
TOUCHED_M = np.array([0.02, 0.13])


def cases_of(protocol, segments=SEGMENTS, seed=0):
    chunks = range(len(chunk_sizes(protocol.samples)))
    dimensions = protocol.dimensions(segments)
    points = np.concatenate([unit_points(dimensions, seed, chunk) for chunk in chunks])
    return protocol.cases(np.tile(TOUCHED_M, (segments, 1)), points[: protocol.samples])


def chi_square_bound(counts):
    """The statistic of equal shares, and what it stays below with probability 0.999."""
    expected = counts.sum() / counts.size
    return ((counts - expected) ** 2 / expected).sum(), chi2.ppf(0.999, counts.size - 1)


def test_single_contact_touches_every_segment_equally_often():
    contacts = cases_of(SingleContact()).contacts
    assert contacts.sum(axis=1).max() == 1
    shares = np.append(contacts.sum(axis=0), (~contacts.any(axis=1)).sum()) / len(contacts)
    assert shares == pytest.approx(0.2, abs=0.002)


@pytest.mark.parametrize("segment", range(SEGMENTS))
def test_single_contact_leaves_no_direction_or_magnitude_out(segment):
    cases = cases_of(SingleContact())
    touched = cases.contacts[:, segment]
    angle = cases.angles_deg[touched, segment]
    magnitude = cases.magnitudes_n[touched, segment]
    in_angle, _ = np.histogram(angle, bins=36, range=(0.0, 360.0))
    in_magnitude, _ = np.histogram(magnitude, bins=20, range=(0.0, 200.0))
    for counts in (in_angle, in_magnitude):
        statistic, bound = chi_square_bound(counts)
        assert statistic < bound
    together, *_ = np.histogram2d(angle, magnitude, bins=(18, 10), range=((0, 360), (0, 200)))
    assert together.min() >= 1


def test_multi_contact_refuses_more_contacts_than_segments():
    with pytest.raises(DatasetError, match="the arm has 4 segments"):
        cases_of(MultiContact(max_contacts=5))


def test_seeds_differ_and_chunks_continue_one_sequence():
    a, b = (unit_points(3, seed, 0) for seed in (0, 1))
    assert not np.isclose(a, b).all(axis=1).any()
    both = np.concatenate([unit_points(3, 0, chunk) for chunk in (0, 1)])
    assert len(np.unique(both, axis=0)) == 2 * CHUNK_SAMPLES
    # a base-2 sequence: the first 4096 points lie one in each of 4096 equal slices
    assert (np.bincount((both[:, 0] * 2 * CHUNK_SAMPLES).astype(int)) == 1).all()


@settings(max_examples=40, deadline=None)
@given(
    kind=st.sampled_from([SingleContact, MultiContact, AnywhereContact]),
    segments=st.integers(1, 16),
    low=st.floats(0.0, 100.0),
    span=st.floats(1e-3, 1000.0),
    share=st.none() | st.sampled_from([0.0, 1.0]) | st.floats(0.0, 1.0),
    pose=st.sampled_from(["straight", "random"]),
    seed=st.integers(0, 2**63 - 1),
)
def test_labels_agree_with_each_other_and_with_the_options(
    kind, segments, low, span, share, pose, seed
):
    protocol = kind(
        samples=256, force_low_n=low, force_high_n=low + span, no_contact_fraction=share, pose=pose
    )
    cases = cases_of(protocol, segments, seed)
    contacts = cases.contacts
    for labels in (cases.angles_deg, cases.magnitudes_n, cases.places_m, cases.along_n):
        assert not labels[~contacts].any()
    assert (cases.places_m[contacts] >= TOUCHED_M[0]).all()
    assert (cases.places_m[contacts] <= TOUCHED_M[1]).all()
    assert (cases.magnitudes_n[contacts] >= low).all()
    assert (cases.magnitudes_n[contacts] <= low + span).all()
    assert (cases.angles_deg >= 0.0).all()
    assert (cases.angles_deg < 360.0).all()
    expected = 1.0 / (segments + 1) if share is None else share
    assert (~contacts.any(axis=1)).mean() == pytest.approx(expected, abs=0.02)
    assert np.abs(cases.command_rad).max() <= np.deg2rad(10.0)
    assert protocol_from_options(protocol.options()) == protocol


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"samples": 0}, "samples = 0: must be at least 1"),
        ({"samples": 2**31}, "samples"),
        ({"samples": True}, "whole number"),
        ({"pose": "bent"}, "must be 'straight' or 'random'"),
        ({"pose_range_deg": 46.0}, "must be at most 45.0"),
        ({"force_high_n": float("inf")}, "force_high_n = inf"),
        ({"force_low_n": 50.0, "force_high_n": 20.0}, "must be below"),
        ({"no_contact_fraction": 1.1}, "must be at most 1.0"),
        ({"max_contacts": 2}, "unknown option 'max_contacts'; valid options: samples"),
        ({"kind": "triple"}, "one of single, multi, anywhere"),
        ({"kind": ["single"]}, "one of single, multi"),
        ({"kind": "anywhere", "axial_share": -0.1}, "axial_share"),
    ],
)
def test_refuses_options_out_of_range(options, message):
    with pytest.raises(DatasetError, match=message):
        protocol_from_options({"kind": "single", **options})


def test_names_are_known_each_once_and_all_means_all() -> None:
    assert effect_names("sensor_gain, payload,payload") == ["payload", "sensor_gain"]
    assert {*known_effects()} - {*effect_names("all")} == {"load_cell"}


@pytest.mark.parametrize("randomise", ["rust", "payload,", "all,payload", "load_cell"])
def test_what_is_no_effect_is_refused_with_those_there_are(randomise: str) -> None:
    with pytest.raises(DatasetError, match=r"is no effect; give all, or names from .*payload"):
        effect_names(randomise)


def many(name: str, draws: int = 400) -> list:
    rng = np.random.default_rng(1)
    return [entry for _ in range(draws) for entry in drawn_entries([name], 4, 12, rng)]


@pytest.mark.parametrize("name", list(known_effects()))
def test_every_number_is_in_its_range_and_sizes_are_typical(name: str) -> None:
    effect = known_effects()[name]
    drawn = many(name)
    for parameter in effect.parameters:
        values = np.array([entry.values[parameter.name] for entry in drawn])
        assert (values >= parameter.low).all()
        assert (values <= parameter.high).all()
        if parameter.role == "size":
            assert np.sqrt((values**2).mean()) == pytest.approx(parameter.typical, rel=0.25)
            assert (values < 0.0).any() == (parameter.low < 0.0)
