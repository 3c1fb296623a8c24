"""Edited files: arms, channel maps, their DBC files, calibrations, models, recordings, states.

An example is one file: written, read, and either refused in one line or found to be usable.
"""

from __future__ import annotations

import itertools
import shutil
import tempfile
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import can
import numpy as np
import onnx
from fuzz_edits import (
    Draw,
    FalseAnswerError,
    Outcome,
    Target,
    edited_bytes,
    edited_text,
    require_one_line,
)
from fuzz_live import ARM, SETTINGS, TaredEstimation
from hypothesis import strategies as st

from cablesense_base import CableSenseError
from cablesense_base.installation import config_path
from cablesense_gap.recordings.checks import read_recording
from cablesense_online.can.bus import FaultLedger
from cablesense_online.can.channel_map import calibrated, load_calibration, open_channel_map
from cablesense_online.can.reader import FrameDecoder
from cablesense_online.estimation import Estimation
from cablesense_online.state_file import StateFile
from cablesense_sim.arm import bundled_arms, find_arm, load_arm, parse_arm
from cablesense_sim.build import mechanism_of
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.parquet import read_dataset, write_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.temporal_estimator import open_estimator

_MAPS = tuple(
    config_path(f"can/{name}.yaml") for name in ("twelve_channel_amplifier", "cia404_amplifier")
)
_MODELS = {
    "cdsm_tensions_only": 4, "peers/cdsm_straight_two_stage": 4, "peers/cdsm_closed_form": 2,
    "cdsm": 1, "cdsm_anywhere": 1,
}  # fmt: skip
"""With how often each is taken: the smaller the more often."""

MOST_ROWS = 2_400
_EXAMPLES = Path(__file__).parent / "fuzz_examples"
Edit = Callable[[Draw, Any], bytes]
Use = Callable[[Path], None]
"""Reads a file and judges its content; raises `CableSenseError` for a refused one."""


def _check(name: str, draw: Draw) -> Outcome:
    """An example is a file in the working folder: one of a kind edited, and taken or refused."""
    suffix, edit, use, _ = _READERS[name]
    path = Path(f"item.{suffix}").absolute()
    path.write_bytes(edit(draw, draw(st.sampled_from(_examples(name)))))
    try:
        use(path)
    except CableSenseError as error:
        require_one_line(error)
        return Outcome(refused=1)
    return Outcome(taken=1)


@cache
def _examples(name: str) -> Sequence[Any]:
    """Valid contents of files of a kind."""
    match name:
        case "arms":
            texts = [find_arm(arm).read_text(encoding="utf-8") for arm in bundled_arms()]
            return [*texts, texts[0] + _text("effects.yaml")]
        case "maps":
            return [path.read_text(encoding="utf-8") for path in _MAPS]
        case "dbc":
            return [path.with_suffix(".dbc").read_text(encoding="utf-8") for path in _MAPS]
        case "calibrations":
            return [_text("calibration.yaml")]
        case "models":
            names = [name for name, often in _MODELS.items() for _ in range(often)]
            return [find_model(name).read_bytes() for name in names]
        case "csv":
            return [_text("recording.csv")]
        case "mcap":
            return [(_EXAMPLES / "recording.mcap").read_bytes()]
        case "parquet":
            with tempfile.TemporaryDirectory() as folder:
                whole = Path(folder, "whole.parquet")
                write_dataset(whole, draw_dataset(ARM, SingleContact(samples=40), seed=0))
                return [whole.read_bytes()]
        case _:
            state = TaredEstimation().take_pushed().state
            assert state is not None
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder, "state.json")
                file = StateFile(path, 60.0)
                file.keep(state)
                file.flush()
                return [path.read_text(encoding="utf-8")]


def _text(name: str) -> str:
    return (_EXAMPLES / name).read_text(encoding="utf-8")


def _use_arm(path: Path) -> None:
    arm = load_arm(path)
    if parse_arm(path.read_text(encoding="utf-8-sig")).identity != arm.identity:
        raise FalseAnswerError("the same text gives two arms")
    mechanism_of(arm)
    numbers = [arm.cables.pretension_n, arm.segments.plate_offset_m, *arm.gravity_m_s2]
    if not np.isfinite(numbers).all():
        raise FalseAnswerError(f"an arm with {numbers}")


def _edited_database(draw: Draw, text: str) -> bytes:
    return edited_text(draw, text, _text("statements.dbc").splitlines(keepends=True))


def _use_database(path: Path) -> None:
    """Read it with each bundled map; it is refused where no map can use it."""
    for bundled in _MAPS:
        shutil.copyfile(path, path.with_name(f"{bundled.stem}.dbc"))
    first, second = (shutil.copyfile(one, path.with_name(one.name)) for one in _MAPS)
    try:
        _open_and_decode(first)
    except CableSenseError as error:
        require_one_line(error)
        _open_and_decode(second)


def _use_map(path: Path) -> None:
    for database in (one.with_suffix(".dbc") for one in _MAPS):
        shutil.copyfile(database, path.with_name(database.name))
    _open_and_decode(path)


def _open_and_decode(path: Path) -> None:
    """Open a map; what opens must decode any frame."""
    channel_map, database = open_channel_map(path)
    decoder = FrameDecoder(channel_map, database, FaultLedger())
    low, high = channel_map.range_n
    short = [message for message in database.messages if message.length <= 8]
    for message, fill in itertools.product(short, (b"\x00", b"\xff", b"\x7f", b"\x80")):
        frame = can.Message(
            arbitration_id=message.frame_id,
            is_extended_id=message.is_extended_frame,
            data=fill * message.length,
        )
        decoded = decoder.decode(frame)
        for _, tension_n in decoded.readings if decoded is not None and decoded.valid else ():
            if not low < tension_n < high:
                raise FalseAnswerError(f"a reading of {tension_n} N outside {low} … {high}")


def _use_calibration(path: Path) -> None:
    found = calibrated(*open_channel_map(_MAPS[0].stem), load_calibration(path), str(path))
    for channel in found.channels.values():
        if not np.isfinite([channel.scale_n_per_unit, channel.zero]).all():
            raise FalseAnswerError(f"a calibration of {channel}")


def _edited_model(draw: Draw, content: bytes) -> bytes:
    """As bytes, or in its metadata, or with a tensor that lies in another file."""
    if draw(st.booleans()):
        return edited_bytes(draw, content)
    model = onnx.load_model_from_string(content)
    if draw(st.integers(0, 9)) == 9:
        tensor = draw(st.sampled_from(list(model.graph.initializer)))
        tensor.external_data.add(key="location", value="/etc/passwd")
        tensor.data_location = onnx.TensorProto.EXTERNAL
    entry = draw(st.sampled_from(list(model.metadata_props)))
    entry.value = (
        edited_text(draw, entry.value).decode("utf-8", errors="replace").replace("\0", "")
    )
    return bytes(model.SerializeToString())


def _use_model(path: Path) -> None:
    estimator = open_estimator(path)
    assert isinstance(estimator, Estimator)
    command = np.zeros(estimator.metadata.arm.joint_count)
    for scale in (0.0, 1.0, 50.0):
        row = np.linspace(-scale, scale, len(estimator.metadata.cable_names))
        estimate = estimator.estimate(row, command)
        if not np.isfinite([*estimate.probabilities, *estimate[2:8]]).all():
            raise FalseAnswerError(f"a model estimates {estimate}")


def _use_recording(path: Path) -> None:
    recording = read_recording(path, ARM)
    rows = len(recording)
    tensions_n = recording.tensions_n
    if tensions_n.shape != (rows, ARM.cable_count) or not np.isfinite(tensions_n).all():
        raise FalseAnswerError(f"a recording with tensions of shape {tensions_n.shape}")
    if recording.command_rad.shape != (rows, ARM.joint_count):
        raise FalseAnswerError(f"commands of shape {recording.command_rad.shape}")
    if not (np.diff(recording.time_s) > 0.0).all() or rows > MOST_ROWS:
        raise FalseAnswerError(f"{rows} rows whose time does not ascend")


def _edited_dataset(draw: Draw, content: bytes) -> bytes:
    at = 0
    if draw(st.booleans()):  # offsets and sizes stand at the end
        at = draw(st.integers(max(0, len(content) - 12_000), len(content)))
    return content[:at] + edited_bytes(draw, content[at:], most=2)


def _use_dataset(path: Path) -> None:
    read = read_dataset(path, ARM)
    if not np.isfinite(read.tension_difference_n).all() or len(read) > 2_000_000:
        raise FalseAnswerError(f"a dataset of {len(read)} rows that are not all numbers")


def _use_state(path: Path) -> None:
    found = StateFile(path, 60.0).read(ARM.identity)
    if found is None:
        raise FalseAnswerError("a file that exists is read as missing")
    estimation = Estimation(ARM, Estimator.load(find_model("cdsm"), ARM), SETTINGS, 0.0)
    estimation.restore(found)
    restored_n = estimation.tares.unloaded_n
    if restored_n is None or not np.isfinite(restored_n).all():
        raise FalseAnswerError(f"unloaded tensions {restored_n}")


_READERS: dict[str, tuple[str, Edit, Use, int]] = {
    "arms": ("yaml", edited_text, _use_arm, 3_000),
    "models": ("onnx", _edited_model, _use_model, 3_000),
    "csv": ("csv", edited_text, _use_recording, 1_500),
    "mcap": ("mcap", edited_bytes, _use_recording, 2_000),
    "parquet": ("parquet", _edited_dataset, _use_dataset, 1_500),
    "dbc": ("dbc", _edited_database, _use_database, 2_000),
    "maps": ("yaml", edited_text, _use_map, 1_000),
    "calibrations": ("yaml", edited_text, _use_calibration, 1_000),
    "states": ("json", edited_text, _use_state, 1_000),
}
"""Suffix, edit, use, and how many examples."""

FILE_TARGETS = {
    name: Target("files", partial(_check, name), examples)
    for name, (*_, examples) in _READERS.items()
}
