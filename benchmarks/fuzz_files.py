"""Mutated files: arms, channel maps, their DBC files, calibrations, models, recordings, states.

An item is one file: written, read, and either refused in one line or found to be usable.
"""

from __future__ import annotations

import itertools
import json
import random
import shutil
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np
import onnx
from fuzz_messages import SETTINGS
from fuzz_mutation import VALUES, mutated_bytes, mutated_text, mutated_yaml
from fuzz_watched import FalseAnswerError, Outcome, Run, item_random, require_one_line
from onnx import AttributeProto, ModelProto, helper

from cablesense_base.errors import CableSenseError
from cablesense_base.installation import config_path
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.recordings.csv_file import write_csv
from cablesense_gap.recordings.mcap_file import write_mcap
from cablesense_gap.recordings.recording import Recording
from cablesense_online.can.bus import FaultLedger
from cablesense_online.can.calibration import calibrated, load_calibration
from cablesense_online.can.channel_map import open_channel_map
from cablesense_online.can.decoder import FrameDecoder
from cablesense_online.estimation import Estimation
from cablesense_online.state import EstimatorState, StateFile
from cablesense_sim.arm import bundled_arms, find_arm, load_arm, open_arm, parse_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.parquet import read_dataset, write_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model

ARM = open_arm("cdsm")
_MAPS = tuple(
    config_path(f"can/{name}.yaml") for name in ("twelve_channel_amplifier", "cia404_amplifier")
)
_MODELS = ("cdsm_tensions_only", "peers/cdsm_straight_two_stage", "peers/cdsm_closed_form", "cdsm")
_MODEL_WEIGHTS = (4, 4, 2, 1)
_ROWS = 24

_EFFECTS = """
effects:
  - {effect: payload, at: segment_2, parameters: {mass_kg: 0.3}}
  - {effect: sensor_gain, at: cable_3, parameters: {gain: 1.02}}
"""
_DBC_WORDS = """BO_ 1 A: 8 X\nBO_ 289 TENSIONS_1_TO_4: 1 X\n SG_ s : 0|64@1- (1,0) [0|0] "" X
 SG_ m M : 7|3@0+ (1e9,-1) [0|0] "" X\n SG_ f m0 : 0|32@1- (1,0) [0|0] "" X
SIG_VALTYPE_ 289 TENSION_1 : 1;\nVAL_ 289 TENSION_1 1 "a" 2 "b" ;\nBA_ "VFrameFormat" BO_ 289 14;
CM_ "a" ;\nBO_TX_BU_ 289 : X;\nSIG_GROUP_ 289 g 1 : TENSION_1;\nVAL_TABLE_ t 1 "x" ;
"""
_MCAP_WORDS = (
    b"sensor_msgs", b"JointState", b"cdr", b"zstd", b"lz4", b"ros2msg", b"/cable_tensions",
)  # fmt: skip
_OPERATORS = (
    "Loop", "If", "Scan", "NonZero", "Identity", "MatMul", "Reshape", "Gather", "Slice", "Pad",
    "Expand", "Tile", "Split", "Concat", "Transpose", "Softmax", "GRU", "Conv", "Range", "ArgMax",
    "Einsum", "Resize", "ConstantOfShape", "ScatterND", "StringSplit", "",
)  # fmt: skip
_INTEGERS = (0, 1, -1, 2, 7, 100, 2**20, 2**31, -(2**31), 2**40, 2**62, -(2**63), 2**63 - 1)

Make = Callable[[random.Random, int], tuple[bytes, str]]
Use = Callable[[Path], None]


def _file_run(name: str, seed: int, make: Make, use: Use) -> Run:
    """Items are files: `make` gives bytes and suffix of one, `use` reads it and judges the answer.

    `use` raises `CableSenseError` for what is refused.
    """
    folder = tempfile.TemporaryDirectory(prefix="fuzz_")

    def run(item: int) -> Outcome:
        content, suffix = make(item_random(name, seed, item), item)
        path = Path(folder.name) / f"item{suffix}"
        path.write_bytes(content)
        try:
            use(path)
        except CableSenseError as error:
            require_one_line(error)
            return Outcome(refused=1)
        return Outcome(taken=1)

    return run


def make_arms(seed: int) -> Run:
    """The bundled arms, and one with effects."""
    texts = [find_arm(name).read_text(encoding="utf-8") for name in bundled_arms()]
    texts.append(texts[0] + _EFFECTS)

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        text = rng.choice(texts)
        changed = mutated_yaml(rng, text) if item % 2 else mutated_text(rng, text, texts)
        return changed, ".yaml"

    def use(path: Path) -> None:
        arm = load_arm(path)
        if parse_arm(path.read_text(encoding="utf-8-sig")).identity != arm.identity:
            raise FalseAnswerError("the same text gives two arms")
        mechanism_of(arm)
        numbers = [arm.cables.pretension_n, arm.segments.plate_offset_m, *arm.gravity_m_s2]
        if not np.isfinite(numbers).all():
            raise FalseAnswerError(f"an arm with {numbers}")

    return _file_run("arms", seed, make, use)


def make_dbc(seed: int) -> Run:
    """A bundled map, read beside a DBC file that was changed; what opens must decode any frame."""
    texts = [path.with_suffix(".dbc").read_text(encoding="utf-8") for path in _MAPS]
    folder = tempfile.TemporaryDirectory(prefix="fuzz_dbc_")

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        return mutated_text(rng, texts[item % 2], [texts[item % 2], _DBC_WORDS]), f".{item % 2}"

    def use(path: Path) -> None:
        bundled = _MAPS[int(path.suffix[1:])]
        channel_map = Path(folder.name) / bundled.name
        shutil.copyfile(bundled, channel_map)
        shutil.copyfile(path, channel_map.with_suffix(".dbc"))
        _open_and_decode(channel_map)

    return _file_run("dbc", seed, make, use)


def make_maps(seed: int) -> Run:
    """A channel map that was changed, beside its DBC file."""
    texts = [path.read_text(encoding="utf-8") for path in _MAPS]
    folder = tempfile.TemporaryDirectory(prefix="fuzz_map_")
    for path in _MAPS:
        shutil.copyfile(path.with_suffix(".dbc"), Path(folder.name) / f"{path.stem}.dbc")

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        text = texts[item % 2]
        return (mutated_yaml(rng, text) if item % 3 else mutated_text(rng, text)), ".yaml"

    def use(path: Path) -> None:
        _open_and_decode(Path(shutil.copyfile(path, Path(folder.name) / "map.yaml")))

    return _file_run("maps", seed, make, use)


def _open_and_decode(path: Path) -> None:
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


def make_calibrations(seed: int) -> Run:
    """A calibration that was changed."""
    channel_map, database = open_channel_map(_MAPS[0].stem)
    lines = [f"map: {_MAPS[0].stem}", "made: 2026-01-02T03:04:05Z", "gravity_m_s2: 9.81"]
    lines.append("cables:")
    lines += [
        f"  {cable}: {{message: {channel.message}, signal: {channel.signal}, "
        "signal_unit: N, signal_factor: 0.1, signal_offset: 0.0, scale_n_per_unit: 1.01, "
        "zero: 0.2, points: 5}"
        for cable, channel in channel_map.channels.items()
    ]
    text = "\n".join(lines) + "\n"

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        return (mutated_yaml(rng, text) if item % 2 else mutated_text(rng, text)), ".yaml"

    def use(path: Path) -> None:
        found = calibrated(channel_map, database, load_calibration(path), str(path))
        for channel in found.channels.values():
            if not np.isfinite([channel.scale_n_per_unit, channel.zero]).all():
                raise FalseAnswerError(f"a calibration of {channel}")

    return _file_run("calibrations", seed, make, use)


def make_models(seed: int) -> Run:
    """Four bundled models, the smaller ones more often, as bytes, metadata and graphs."""
    contents = [find_model(name).read_bytes() for name in _MODELS]
    changes = (_node, _node, _attribute, _tensor, _tensor, _metadata, _edges)

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        content = rng.choices(contents, _MODEL_WEIGHTS)[0]
        if item % 3 == 0:
            return mutated_bytes(rng, content, contents), ".onnx"
        model = onnx.load_model_from_string(content)
        for _ in range(rng.choice((1, 1, 2, 3))):
            rng.choice(changes)(rng, model)
        return model.SerializeToString(), ".onnx"

    def use(path: Path) -> None:
        estimator = Estimator.load(path)
        command = np.zeros(estimator.metadata.arm.joint_count)
        for scale in (0.0, 1.0, 50.0):
            row = np.linspace(-scale, scale, len(estimator.cable_names))
            estimate = estimator.estimate(row, command)
            if not np.isfinite([*estimate.probabilities, *estimate[2:]]).all():
                raise FalseAnswerError(f"a model estimates {estimate}")

    return _file_run("models", seed, make, use)


def _node(rng: random.Random, model: ModelProto) -> None:
    node = rng.choice(model.graph.node)
    action = rng.randrange(6)
    if action == 0:
        node.op_type = rng.choice(_OPERATORS)
    elif action == 1:
        node.domain = rng.choice(("", "ai.onnx", "com.microsoft", "ai.onnx.ml", "x", "\0"))
    elif action == 2 and node.input:
        names = [name for other in model.graph.node for name in other.output]
        node.input[rng.randrange(len(node.input))] = rng.choice((*names, "", "nowhere"))
    elif action == 3 and node.input:
        del node.input[rng.randrange(len(node.input)) :]
    elif action == 4:
        node.output.append(rng.choice(("", "more", *node.output)))
    else:
        model.graph.node.remove(node)


def _attribute(rng: random.Random, model: ModelProto) -> None:
    node = rng.choice([n for n in model.graph.node if n.attribute] or model.graph.node)
    if not node.attribute or rng.random() < 0.2:
        name = rng.choice(("axis", "axes", "perm", "to", "value", "then_branch", "hidden_size"))
        node.attribute.append(helper.make_attribute(name, rng.choice(_INTEGERS)))
        return
    attribute = rng.choice(node.attribute)
    if attribute.type == AttributeProto.INT:
        attribute.i = rng.choice(_INTEGERS)
    elif attribute.type == AttributeProto.INTS:
        attribute.ints[:] = rng.choices(_INTEGERS, k=rng.choice((0, 1, 2, 9)))
    else:
        attribute.type = rng.randrange(15)


def _tensor(rng: random.Random, model: ModelProto) -> None:
    tensor = rng.choice(model.graph.initializer)
    action = rng.randrange(6)
    if action == 0 and tensor.dims:
        tensor.dims[rng.randrange(len(tensor.dims))] = rng.choice(_INTEGERS)
    elif action == 1:
        tensor.data_type = rng.randrange(30)
    elif action == 2:
        tensor.raw_data = mutated_bytes(rng, tensor.raw_data, most=2)
    elif action == 3:
        tensor.external_data.add(key="location", value="/etc/passwd")
        tensor.data_location = rng.choice((0, 1))
    elif action == 4:
        tensor.dims.append(rng.choice(_INTEGERS))
    else:
        values = np.frombuffer(tensor.raw_data[: len(tensor.raw_data) // 8 * 8]).copy()
        if values.size:
            extremes = (np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0, 5e-324)
            values[rng.randrange(values.size)] = rng.choice(extremes)
            tensor.raw_data = values.tobytes()


def _metadata(rng: random.Random, model: ModelProto) -> None:
    for entry in model.metadata_props:
        if entry.key == "cablesense" and rng.random() < 0.5:
            text = mutated_text(rng, entry.value).decode("utf-8", errors="replace")
            entry.value = text.replace("\0", "")
        elif entry.key == "cablesense":
            try:
                content = json.loads(entry.value)
                key = rng.choice(list(content))
            except (ValueError, TypeError, IndexError, RecursionError):  # changed as text
                continue
            content[key] = rng.choice((None, "", -1, 1e308, [], {}, "x" * 5000, True, [1] * 400))
            entry.value = json.dumps(content)


def _edges(rng: random.Random, model: ModelProto) -> None:
    values = [*model.graph.input, *model.graph.output]
    value = rng.choice(values)
    tensor = value.type.tensor_type
    action = rng.randrange(4)
    if action == 0:
        tensor.elem_type = rng.randrange(25)
    elif action == 1 and tensor.shape.dim:
        rng.choice(tensor.shape.dim).dim_value = rng.choice(_INTEGERS)
    elif action == 2:
        value.name = rng.choice(("", "x", rng.choice(values).name))
    else:
        model.opset_import[0].version = rng.choice((0, 1, 7, 13, 99, -1, 2**40))


def make_csv(seed: int) -> Run:
    """A recording of some rows as text, changed as text."""
    text = _content(".csv", lambda path: write_csv(path, _recording())).decode()

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        return mutated_text(rng, text), ".csv"

    return _file_run("csv", seed, make, _use_recording)


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
                word = rng.choice(_MCAP_WORDS)
                where = changed.find(word)
                if where >= 0:
                    changed[where : where + len(word)] = rng.randbytes(len(word))
            else:
                changed = bytearray(mutated_bytes(rng, bytes(changed), most=1))
                changed += bytes(max(0, 16 - len(changed)))
        return bytes(changed), ".mcap"

    return _file_run("mcap", seed, make, _use_recording)


def make_parquet(seed: int) -> Run:
    """A dataset of some samples."""
    dataset = draw_dataset(ARM, SingleContact(samples=40), seed=0)
    content = _content(".parquet", lambda path: write_dataset(path, dataset))

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        if rng.random() < 0.5:  # offsets and sizes stand at the end
            at = rng.randrange(max(0, len(content) - 12_000), len(content))
            return content[:at] + mutated_bytes(rng, content[at:], most=2), ".parquet"
        return mutated_bytes(rng, content), ".parquet"

    def use(path: Path) -> None:
        read = read_dataset(path, ARM)
        if not np.isfinite(read.tension_difference_n).all() or len(read) > 2_000_000:
            raise FalseAnswerError(f"a dataset of {len(read)} rows that are not all numbers")

    return _file_run("parquet", seed, make, use)


def _use_recording(path: Path) -> None:
    recording = read_recording(path, ARM)
    rows = len(recording)
    tensions_n = recording.tensions_n
    if tensions_n.shape != (rows, ARM.cable_count) or not np.isfinite(tensions_n).all():
        raise FalseAnswerError(f"a recording with tensions of shape {tensions_n.shape}")
    if recording.command_rad.shape != (rows, ARM.joint_count):
        raise FalseAnswerError(f"commands of shape {recording.command_rad.shape}")
    if not (np.diff(recording.time_s) > 0.0).all() or rows > 100 * _ROWS:
        raise FalseAnswerError(f"{rows} rows whose time does not ascend")


def _recording() -> Recording:
    rng = np.random.default_rng(0)
    segment = np.repeat([0, 2], _ROWS // 2)
    load_n = np.zeros((_ROWS, 3))
    load_n[segment > 0, 2] = -9.81
    return Recording(
        name="fuzz",
        time_s=np.arange(_ROWS) * 0.2,
        trial=np.repeat([1, 2], _ROWS // 2),
        command_rad=np.full((_ROWS, ARM.joint_count), 0.05),
        load_segment=segment,
        load_n=load_n,
        tensions_n=rng.uniform(20.0, 90.0, (_ROWS, ARM.cable_count)),
    )


def _content(suffix: str, write: Callable[[Path], object]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"whole{suffix}"
        write(path)
        return path.read_bytes()


def make_states(seed: int) -> Run:
    """A state that was written, changed as text or in one of its values."""
    estimator = Estimator.load(find_model("cdsm"), ARM)
    straight = (0.0,) * ARM.joint_count
    unloaded = tuple(solve_equilibrium(mechanism_of(ARM), straight).tensions_n.tolist())
    state = EstimatorState(
        before_ns=10**18 + 1,
        events=(),
        arm=ARM.identity,
        settings=SETTINGS,
        command_rad=straight,
        lowest_rad=straight,
        highest_rad=straight,
        rest_from_ns=0,
        unloaded_n=unloaded,
        tared_n=unloaded,
        tare_command_rad=straight,
    )

    def write(path: Path) -> None:
        file = StateFile(path, 60.0)
        file.keep(state)
        file.flush()

    text = _content(".json", write).decode()

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        if item % 2:
            return mutated_text(rng, text), ".json"
        values = json.loads(text)
        key = rng.choice(list(values))
        if isinstance(values[key], list) and rng.random() < 0.6:
            values[key][rng.randrange(len(values[key]))] = rng.choice(VALUES)
        else:
            values[key] = rng.choice(VALUES)
        return json.dumps(values).encode("utf-8", errors="surrogatepass"), ".json"

    def use(path: Path) -> None:
        found = StateFile(path, 60.0).read(ARM.identity)
        if found is None:
            raise FalseAnswerError("a file that exists is read as missing")
        estimation = Estimation(ARM, estimator, SETTINGS, 0.0)
        estimation.restore(found)
        restored_n = estimation.tares.unloaded_n
        if restored_n is None or not np.isfinite(restored_n).all():
            raise FalseAnswerError(f"unloaded tensions {restored_n}")

    return _file_run("states", seed, make, use)
