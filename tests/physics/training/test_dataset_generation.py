"""Datasets do not depend on where they are drawn; arms with effects have their history."""

from __future__ import annotations

import hashlib
import re

import distributed
import numpy as np
import pytest

from cablesense_sim.arm import open_arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_training import cluster
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset, generate
from cablesense_training.data.parquet import produce_dataset
from cablesense_training.data.protocols import CHUNK_SAMPLES, AnywhereContact, SingleContact
from cablesense_training.errors import DatasetError
from tests.helpers.arm_variants import variant

PROTOCOL = SingleContact(samples=CHUNK_SAMPLES + 100, pose="random", tare_samples=5)


@pytest.fixture(scope="module")
def arm():
    return open_arm("cdsm")


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture(scope="module")
def one_worker(arm, tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "one.parquet"
    produce_dataset(path, arm, PROTOCOL, 7, command="")
    return digest(path)


@pytest.mark.slow
def test_worker_processes_write_the_same_bytes(arm, one_worker, tmp_path):
    path = tmp_path / "more.parquet"
    summary = produce_dataset(path, arm, PROTOCOL, 7, command="", workers=2)
    assert summary.rows == PROTOCOL.samples
    assert digest(path) == one_worker


@pytest.mark.slow
def test_a_dask_cluster_does_the_same(arm, one_worker, dask_address, tmp_path, monkeypatch):
    path = tmp_path / "dask.parquet"
    produce_dataset(path, arm, PROTOCOL, 7, command="", dask_scheduler=dask_address)
    assert digest(path) == one_worker
    with pytest.raises(ValueError, match="invalid literal"):  # errors of the function stay theirs
        list(cluster.map_on_cluster(dask_address, int, ["x"]))
    monkeypatch.setattr(distributed.Client, "run", lambda *_: {"tcp://other": "0.0.0"})
    with pytest.raises(DatasetError, match=r"tcp://other runs version 0.0.0 .*install"):
        list(generate(arm, PROTOCOL, 7, dask_scheduler=dask_address))


@pytest.mark.slow
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x"])
def test_a_scheduler_out_of_reach_is_named(arm, monkeypatch, address):
    monkeypatch.setattr(cluster, "PATIENCE_S", 0.5)
    with pytest.raises(DatasetError, match=re.escape(f"no Dask cluster works at {address!r}")):
        list(generate(arm, PROTOCOL, 0, dask_scheduler=address))


NOMINAL = mechanism_of(open_arm("cdsm_lab"))
GENTLE = {"samples": 96, "pose": "random", "force_high_n": 25.0, "noise": False}


def listing(*effects: tuple[str, str, dict[str, float]]):
    listed = [{"effect": name, "at": at, "parameters": p} for name, at, p in effects]
    return variant({"effects": listed}, "cdsm_lab")


def drawn(arm, **options) -> Dataset:
    return draw_dataset(arm, SingleContact(**{**GENTLE, **options}), seed=4)


def test_an_amended_arms_samples_are_its_rests_with_its_own_tare() -> None:
    arm = listing(
        ("payload", "segment_3", {"mass_kg": 0.5}),
        ("routing_geometry", "segment_2", {"plates_angle_rad": 0.03}),
        ("sensor_gain", "cable_5", {"gain": 0.1}),
        ("contact_offset", "segment_2", {"offset_m": 0.02}),
    )
    data = drawn(arm)
    mechanism = amended(NOMINAL, entries_of(arm))
    held = held_lengths_m(NOMINAL, data.command_rad)
    gain = 1.0 + 0.1 * (np.arange(12) == 4)
    unloaded = solve_equilibrium(mechanism, data.command_rad, held_m=held).tensions_n
    loaded = solve_equilibrium(mechanism, data.command_rad, data.forces_n, held_m=held).tensions_n
    np.testing.assert_allclose(data.unloaded_n, gain * unloaded, atol=1e-6)
    np.testing.assert_allclose(data.tension_difference_n, gain * (loaded - unloaded), atol=1e-6)
    np.testing.assert_array_equal(data.slack_cables, (loaded <= 0.0).sum(axis=1))


@pytest.mark.parametrize(
    ("name", "values"),
    [("capstan_friction", {"coefficient": 1e-9}), ("contact_offset", {"offset_m": 0.02})],
)
def test_contacts_anywhere_are_where_they_are_on_an_arm_with_effects(name, values) -> None:
    """Friction too small to matter leaves the rest; loads are placed by the protocol alone."""
    protocol = AnywhereContact(**{**GENTLE, "samples": 12})
    plain = draw_dataset(open_arm("cdsm_lab"), protocol, seed=4)
    marked = draw_dataset(listing((name, "arm", values)), protocol, seed=4)
    np.testing.assert_allclose(marked.tension_difference_n, plain.tension_difference_n, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("randomise", ["payload,sensor_gain", "joint_friction"])
def test_blocks_are_drawn_on_arms_of_their_own(randomise: str) -> None:
    arm = open_arm("cdsm_lab")
    plain = drawn(arm)
    marked = drawn(arm, randomise=randomise)
    off = np.abs(marked.tension_difference_n - plain.tension_difference_n)
    first = off[:64].max(axis=0)
    second = off[64:].max(axis=0)
    assert first.max() > 1e-3
    assert second.max() > 1e-3
    assert np.abs(first - second).max() > 1e-3
    again = drawn(arm, randomise=randomise)
    assert again.tension_difference_n.tobytes() == marked.tension_difference_n.tobytes()
