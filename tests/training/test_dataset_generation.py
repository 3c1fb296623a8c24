"""The same seed gives the same bytes wherever the chunks are computed."""

import hashlib
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import distributed
import pytest

from cablesense_sim.arm import load_arm
from cablesense_training.data import generation
from cablesense_training.data.generation import draw_dataset, generate
from cablesense_training.data.parquet import produce_dataset
from cablesense_training.data.protocols import CHUNK_SAMPLES, MultiContact, SingleContact
from cablesense_training.errors import DatasetError

ARMS = Path(__file__).parents[2] / "config" / "arms"
PROTOCOL = SingleContact(samples=2 * CHUNK_SAMPLES + 100, pose="random")


@pytest.fixture(scope="module")
def arm():
    return load_arm(ARMS / "cdsm.yaml")


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


def test_a_longer_run_begins_like_a_shorter_one(arm):
    short, long = (
        draw_dataset(arm, MultiContact(samples=samples), seed=1)
        for samples in (CHUNK_SAMPLES, CHUNK_SAMPLES + 1)
    )
    first = long.select(slice(0, CHUNK_SAMPLES))
    assert (first.tension_difference_n == short.tension_difference_n).all()


@contextmanager
def dask_process(words, pattern):
    """A Dask process on loopback, and what its log says where `pattern` matches."""
    process = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli." + words[0], *words[1:]],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    try:
        for line in process.stderr:
            found = re.search(pattern, line)
            if found:
                break
        else:
            pytest.fail(f"{words[0]} ended without a line that matches {pattern}")
        yield found.group(0)
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


def scheduler():
    words = ["dask_scheduler", "--host", "tcp://127.0.0.1:0", "--no-dashboard", "--no-jupyter"]
    return dask_process(words, r"tcp://127\.0\.0\.1:\d+")


def worker(address):
    words = ["dask_worker", address, "--host", "127.0.0.1", "--nthreads", "1", "--no-dashboard"]
    return dask_process([*words, "--no-nanny"], r"Registered to")


@pytest.mark.slow
def test_a_dask_cluster_writes_the_same_bytes(arm, one_worker, tmp_path, monkeypatch):
    path = tmp_path / "dask.parquet"
    with scheduler() as address:
        with worker(address), worker(address):
            produce_dataset(path, arm, PROTOCOL, 7, command="", dask_scheduler=address)
            assert digest(path) == one_worker

            beyond = SingleContact(samples=64, force_low_n=5e3, force_high_n=9e3)
            lab = load_arm(ARMS / "cdsm_lab.yaml")
            with pytest.raises(DatasetError, match="lie beyond arm cdsm"):
                produce_dataset(path, lab, beyond, 7, command="", dask_scheduler=address)

            monkeypatch.setattr(distributed.Client, "run", lambda *_: {"tcp://other": "0.0.0"})
            with pytest.raises(
                DatasetError, match=r"tcp://other runs version 0.0.0 .*install the same version"
            ):
                list(generate(arm, PROTOCOL, 7, dask_scheduler=address))
        monkeypatch.setattr(generation, "DASK_PATIENCE_S", 0.5)
        with pytest.raises(DatasetError, match="has no workers; start one with: dask worker"):
            list(generate(arm, PROTOCOL, 7, dask_scheduler=address))
    assert digest(path) == one_worker


@pytest.mark.slow
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x", "127.0.0.1:port", ""])
def test_a_scheduler_out_of_reach_is_named(arm, monkeypatch, address):
    monkeypatch.setattr(generation, "DASK_PATIENCE_S", 0.5)
    with pytest.raises(DatasetError, match=re.escape(f"no Dask scheduler answers at {address!r}")):
        list(generate(arm, PROTOCOL, 0, dask_scheduler=address))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, "seed = -1"),
        ({"seed": 2**63}, "seed = 9223372036854775808"),
        ({"seed": 1.5}, "seed = 1.5: must be a whole number"),
        ({"seed": 0, "workers": 0}, "workers = 0: must be a whole number from 1 to 256"),
        ({"seed": 0, "workers": 257}, "workers = 257"),
    ],
)
def test_refuses_options_out_of_range(arm, options, message):
    with pytest.raises(DatasetError, match=message):
        generate(arm, PROTOCOL, **options)
