"""Recordings as CSV and MCAP, and datasets as Parquet."""

from __future__ import annotations

import random
import struct
import tempfile
from pathlib import Path

import numpy as np

from cablesense_gap.recordings.csv_file import write_csv
from cablesense_gap.recordings.mcap_file import write_mcap
from cablesense_gap.recordings.reading import read_recording
from cablesense_gap.recordings.recording import Recording
from cablesense_sim.arm_files import open_arm
from cablesense_training.data import Dataset, SingleContact, read_dataset, write_dataset
from fuzz.byte_mutation import mutated_bytes
from fuzz.file_item import file_run
from fuzz.target import FalseAnswerError, Run
from fuzz.text_mutation import mutated_text

ROWS = 24
ARM = open_arm("cdsm")
_TYPES = (b"sensor_msgs", b"JointState", b"cdr", b"zstd", b"lz4", b"ros2msg", b"/cable_tensions")


def make_csv(seed: int) -> Run:
    """A recording of some rows as text, changed as text."""
    text = _content(".csv", lambda path: write_csv(path, _recording())).decode()

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        return mutated_text(rng, text), ".csv"

    return file_run("csv", seed, make, _use)


def make_mcap(seed: int) -> Run:
    """The same as topics; changed as bytes, and in the sizes that stand in it."""
    content = _content(".mcap", lambda path: write_mcap(path, _recording(), ARM))

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        changed = bytearray(content)
        for _ in range(rng.choice((1, 1, 2, 4))):
            at = rng.randrange(len(changed) - 8)
            action = rng.randrange(4)
            if action == 0:
                size = rng.choice((0, 1, 9, 2**20, 2**31, 2**32 - 1, 2**40, 2**63, 2**64 - 1))
                changed[at : at + 8] = struct.pack("<Q", size)
            elif action == 1:
                changed[at] = rng.randrange(256)
            elif action == 2:
                word = rng.choice(_TYPES)
                where = changed.find(word)
                if where >= 0:
                    changed[where : where + len(word)] = rng.randbytes(len(word))
            else:
                changed = bytearray(mutated_bytes(rng, bytes(changed), most=1))
                changed += bytes(max(0, 16 - len(changed)))
        return bytes(changed), ".mcap"

    return file_run("mcap", seed, make, _use)


def make_parquet(seed: int) -> Run:
    """A dataset of some samples."""
    dataset = Dataset.from_protocol(ARM, SingleContact(samples=40), seed=0)
    content = _content(".parquet", lambda path: write_dataset(path, dataset))

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        if rng.random() < 0.5:  # the end says where all lies, and how much
            at = rng.randrange(max(0, len(content) - 12_000), len(content))
            return content[:at] + mutated_bytes(rng, content[at:], most=2), ".parquet"
        return mutated_bytes(rng, content), ".parquet"

    def use(path: Path) -> None:
        read = read_dataset(path, ARM)
        if not np.isfinite(read.tension_difference_n).all() or len(read) > 2_000_000:
            raise FalseAnswerError(f"a dataset of {len(read)} rows that are not all numbers")

    return file_run("parquet", seed, make, use)


def _use(path: Path) -> None:
    recording = read_recording(path, ARM)
    rows = len(recording)
    tensions_n = recording.tensions_n
    if tensions_n.shape != (rows, ARM.cable_count) or not np.isfinite(tensions_n).all():
        raise FalseAnswerError(f"a recording with tensions of shape {tensions_n.shape}")
    if recording.command_rad.shape != (rows, ARM.joint_count):
        raise FalseAnswerError(f"commands of shape {recording.command_rad.shape}")
    if not (np.diff(recording.time_s) > 0.0).all() or rows > 100 * ROWS:
        raise FalseAnswerError(f"{rows} rows whose time does not ascend")


def _recording() -> Recording:
    rng = np.random.default_rng(0)
    segment = np.repeat([0, 2], ROWS // 2)
    load_n = np.zeros((ROWS, 3))
    load_n[segment > 0, 2] = -9.81
    return Recording(
        name="fuzz",
        time_s=np.arange(ROWS) * 0.2,
        trial=np.repeat([1, 2], ROWS // 2),
        command_rad=np.full((ROWS, ARM.joint_count), 0.05),
        load_segment=segment,
        load_n=load_n,
        tensions_n=rng.uniform(20.0, 90.0, (ROWS, ARM.cable_count)),
    )


def _content(suffix: str, write: object) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"whole{suffix}"
        write(path)  # type: ignore[operator]
        return path.read_bytes()
