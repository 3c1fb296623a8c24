"""Edited files: arms, channel maps, their DBC files, calibrations, models, recordings.

Calibrations are of sensors, beside a channel map, and of whole arms.

An example is one file: written, read, and either refused in one line or found to be usable.
"""

from __future__ import annotations

import io
import itertools
import shutil
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np
import onnx
from fuzz_edits import Draw, Tally, Target, edited_bytes, edited_text, require, require_one_line
from fuzz_live import ARM, MAPS, SETTINGS, STRAIGHT, rig
from hypothesis import strategies as st

from cablesense_base import Array, CableSenseError
from cablesense_base.installation import config_path
from cablesense_contact.calibration import Calibrator, Unloaded
from cablesense_contact.calibration_file import calibration_of, write_calibration
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.inference.law_model import LawModel
from cablesense_contact.inference.metadata import find_model
from cablesense_online.can.bus import FaultLedger
from cablesense_online.can.channel_map import (
    load_sensor_scales,
    open_channel_map,
    with_sensor_scales,
)
from cablesense_online.can.reader import FrameDecoder
from cablesense_online.contacts import ContactFinder, Situation
from cablesense_online.models import LoadedModel
from cablesense_online.tare import UnloadedArm, with_reading
from cablesense_recording.reading import read_recording
from cablesense_sim.arm import bundled_arms, find_arm, load_arm
from cablesense_sim.build import mechanism_of
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.parquet import read_dataset, write_dataset
from cablesense_training.data.protocols import SingleContact

_MAPS = [config_path(f"can/{name}.yaml") for name in MAPS]
_DATABASES = [path.with_suffix(".dbc") for path in _MAPS]
_MODELS = {
    "peers/cdsm_straight_two_stage": 4,
    "peers/cdsm_two_stage": 4,
    "peers/cdsm_multi_two_stage": 2,
    "cdsm_anywhere": 1,
    "cdsm_lab_anywhere": 1,
}
"""With how often each is taken: the quicker the more often."""

_NUMBERS = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1.0, 1e-300, 1e9, -1e9, 1e300)

MOST_ROWS = 2_400
_EXAMPLES = Path(__file__).parent / "fuzz_examples"


class _Kind(NamedTuple):
    """One kind of files.

    Attributes:
        edit: makes the bytes of an edited file from the content of a valid one.
        use: reads a file and judges its content; raises `CableSenseError` for a refused one.
        examples: how many.
    """

    edit: Callable[[Draw, bytes], bytes]
    use: Callable[[Path], None]
    examples: int


def _check(name: str, draw: Draw) -> Tally:
    """An example is a file in the working folder: one of a kind edited, and taken or refused."""
    kind = _KINDS[name]
    file_name, content = draw(st.sampled_from(_valid(name)))
    path = Path(file_name).absolute()
    path.write_bytes(kind.edit(draw, content))
    try:
        kind.use(path)
    except CableSenseError as error:
        require_one_line(error)
        return Tally(refused=1)
    return Tally(taken=1)


@cache
def _valid(name: str) -> Sequence[tuple[str, bytes]]:
    """Names and contents of valid files of a kind."""
    return [(path.name, path.read_bytes()) for path in _valid_files(name)]


def _valid_files(name: str) -> Sequence[Path]:
    match name:
        case "arms":
            arms = [find_arm(arm) for arm in bundled_arms()]
            with_effects = Path("arm.yaml").absolute()
            effects = (_EXAMPLES / "effects.yaml").read_bytes()
            with_effects.write_bytes(arms[0].read_bytes() + effects)
            return [*arms, with_effects]
        case "maps":
            return _MAPS
        case "dbc":
            return _DATABASES
        case "models":
            return [find_model(model) for model, often in _MODELS.items() for _ in range(often)]
        case "parquet":
            path = Path("dataset.parquet").absolute()
            write_dataset(path, draw_dataset(ARM, SingleContact(samples=40), seed=0))
            return [path]
        case "arm_calibrations":
            path = Path("arm.calibration").absolute()
            _calibrate(path)
            return [path]
        case "calibrations":
            return [_EXAMPLES / "calibration.yaml"]
    return [_EXAMPLES / f"recording.{name}"]


def _use_arm(path: Path) -> None:
    arm = load_arm(path)
    mechanism_of(arm)
    numbers = [arm.cables.pretension_n, arm.segments.plate_offset_m, *arm.gravity_m_s2]
    require(np.isfinite(numbers).all(), f"an arm with {numbers}")


def _edited_database(draw: Draw, content: bytes) -> bytes:
    statements = (_EXAMPLES / "statements.dbc").read_text(encoding="utf-8")
    return edited_text(draw, content, statements.splitlines(keepends=True))


def _use_map(path: Path) -> None:
    """Open an edited map or database beside the bundled others; what opens decodes any frame."""
    for bundled in (*_MAPS, *_DATABASES):
        if bundled.name != path.name:
            shutil.copyfile(bundled, path.with_name(bundled.name))
    channel_map, database = open_channel_map(path.with_suffix(".yaml"))
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
            require(low < tension_n < high, f"{tension_n} N is read outside {low} … {high}")


def _use_calibration(path: Path) -> None:
    scales = load_sensor_scales(path)
    channel_map = with_sensor_scales(*open_channel_map(MAPS[0]), scales, str(path))
    numbers = [
        (channel.scale_n_per_unit, channel.zero) for channel in channel_map.channels.values()
    ]
    require(np.isfinite(numbers).all(), f"a calibration of {numbers}")


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
    value = edited_text(draw, entry.value.encode())
    entry.value = value.decode("utf-8", errors="replace").replace("\0", "")
    return bytes(model.SerializeToString())


def _use_model(path: Path) -> None:
    loaded = LoadedModel.open(path)
    contacts = loaded.contacts(SETTINGS)
    unloaded: UnloadedArm[Any] = contacts.unloaded
    state = unloaded.at(unloaded.begin(), np.zeros(loaded.arm.joint_count))
    untouched_n = np.full(loaded.arm.cable_count, loaded.arm.cables.pretension_n)
    for _ in range(SETTINGS.tare_samples):
        state = with_reading(state, untouched_n.tolist(), SETTINGS.tare_samples)
    _require_finite(contacts, unloaded.taken(state, 0, forced=True), untouched_n)


def _use_recording(path: Path) -> None:
    recording = read_recording(path, ARM)
    rows = len(recording)
    require(
        rows <= MOST_ROWS
        and recording.tensions_n.shape == (rows, ARM.cable_count)
        and recording.command_rad.shape == (rows, ARM.joint_count)
        and np.isfinite(recording.tensions_n).all()
        and (np.diff(recording.time_s) > 0.0).all(),
        f"a recording of {rows} rows: {recording}",
    )


def _edited_dataset(draw: Draw, content: bytes) -> bytes:
    kept = 0
    if draw(st.booleans()):  # offsets and sizes stand at the end
        kept = draw(st.integers(max(0, len(content) - 12_000), len(content)))
    return content[:kept] + edited_bytes(draw, content[kept:], most=2)


def _use_dataset(path: Path) -> None:
    read = read_dataset(path, ARM)
    finite = np.isfinite(read.tension_difference_n).all()
    require(finite and len(read) <= 2_000_000, f"a dataset of {len(read)} rows, finite: {finite}")


def _require_finite(contacts: ContactFinder, state: Any, untouched_n: Array) -> None:
    """Check that readings are refused, or answered by finite numbers."""
    for scale in (0.0, 1.0, 40.0):
        reading_n = untouched_n + np.linspace(-scale, scale, len(untouched_n))
        situation = Situation(np.zeros(STRAIGHT.shape), 1)
        state, stated = contacts.find(state, reading_n, situation)
        assert stated is not None
        numbers = list(stated.probabilities)
        for contact in stated.contacts:
            numbers += contact.wrench
        if stated.estimate is not None:
            numbers += stated.estimate[2:8]
        require(np.isfinite(numbers).all(), f"{stated} is stated")


def _calibrate(path: Path) -> None:
    """Write the calibration of an arm by two unloaded readings."""
    loaded, unloaded_n, _ = rig()
    assert isinstance(loaded.model, LawModel)
    calibrator = Calibrator(FeltArm(ARM), loaded.model)
    unloaded = Unloaded(unloaded_n, STRAIGHT, SETTINGS.tare_samples, 10**18)
    write_calibration(path, calibrator.from_poses([unloaded] * 2), FeltArm(ARM))


def _edited_calibration(draw: Draw, content: bytes) -> bytes:
    """As bytes, or in its header, or in some numbers of its arrays."""
    if draw(st.booleans()):
        return edited_bytes(draw, content)
    with np.load(io.BytesIO(content)) as archive:
        parts = {name: archive[name] for name in archive.files}
    name = draw(st.sampled_from(sorted(parts)))
    part = parts[name]
    if name == "header":
        edited = edited_text(draw, part.tobytes())
        parts[name] = np.frombuffer(edited, dtype=np.uint8)
    else:
        parts[name] = _edited_array(draw, part)
    changed = io.BytesIO()
    np.savez(changed, allow_pickle=False, **parts)
    return changed.getvalue()


def _edited_array(draw: Draw, array: Array) -> Array:
    """An array of another shape or type, or with other numbers."""
    match draw(st.sampled_from(("shape", "type", "numbers", "numbers", "numbers"))):
        case "shape":
            return array[: draw(st.integers(0, len(array)))]
        case "type":
            return array.astype(draw(st.sampled_from(("U8", "i1", "f4", "c16", "?"))))
    flat = array.flatten()
    for _ in range(draw(st.integers(1, 3))):
        index = draw(st.integers(0, len(flat) - 1))
        flat[index] = draw(st.sampled_from(_NUMBERS)) if flat.dtype.kind == "f" else -1
    return flat.reshape(array.shape)


def _use_arm_calibration(path: Path) -> None:
    calibration = calibration_of(path.read_bytes(), FeltArm(ARM), str(path))
    numbers = [calibration.mean, calibration.std]
    require(np.isfinite(numbers).all(), f"a calibration of {numbers}")
    loaded, unloaded_n, _ = rig()
    contacts = loaded.contacts(SETTINGS)
    unloaded: UnloadedArm[Any] = contacts.unloaded
    state = unloaded.at(unloaded.begin(calibration), STRAIGHT)
    _require_finite(contacts, state, unloaded_n)


_KINDS = {
    "arms": _Kind(edited_text, _use_arm, 3_000),
    "models": _Kind(_edited_model, _use_model, 3_000),
    "csv": _Kind(edited_text, _use_recording, 1_500),
    "mcap": _Kind(edited_bytes, _use_recording, 2_000),
    "parquet": _Kind(_edited_dataset, _use_dataset, 1_500),
    "dbc": _Kind(_edited_database, _use_map, 2_000),
    "maps": _Kind(edited_text, _use_map, 1_000),
    "calibrations": _Kind(edited_text, _use_calibration, 1_000),
    "arm_calibrations": _Kind(_edited_calibration, _use_arm_calibration, 1_000),
}
FILE_TARGETS = {
    name: Target("files", partial(_check, name), kind.examples) for name, kind in _KINDS.items()
}
