"""Channel maps, their DBC files, and calibrations of them."""

from __future__ import annotations

import random
import shutil
import tempfile
from pathlib import Path

import can
import numpy as np

from cablesense_ros.can.calibration import calibrated
from cablesense_ros.can.calibration_file import load_calibration
from cablesense_ros.can.channel_map import ChannelMap
from cablesense_ros.can.fault_ledger import FaultLedger
from cablesense_ros.can.frame_decoder import FrameDecoder
from cablesense_ros.can.signal_database import open_channel_map
from cablesense_sim.config_files import config_path
from fuzz.file_item import file_run
from fuzz.target import FalseAnswerError, Run
from fuzz.text_mutation import mutated_text
from fuzz.tree_mutation import mutated_yaml

_NAMES = ("twelve_channel_amplifier", "cia404_amplifier")
_WORDS = """BO_ 1 A: 8 X\nBO_ 289 TENSIONS_1_TO_4: 1 X\n SG_ s : 0|64@1- (1,0) [0|0] "" X
 SG_ m M : 7|3@0+ (1e9,-1) [0|0] "" X\n SG_ f m0 : 0|32@1- (1,0) [0|0] "" X
SIG_VALTYPE_ 289 TENSION_1 : 1;\nVAL_ 289 TENSION_1 1 "a" 2 "b" ;\nBA_ "VFrameFormat" BO_ 289 14;
CM_ "a" ;\nBO_TX_BU_ 289 : X;\nSIG_GROUP_ 289 g 1 : TENSION_1;\nVAL_TABLE_ t 1 "x" ;
"""


def make_dbc(seed: int) -> Run:
    """A bundled map, read beside a DBC file that was changed; what opens must decode any frame."""
    maps = [config_path(f"can/{name}.yaml") for name in _NAMES]
    texts = [path.with_suffix(".dbc").read_text(encoding="utf-8") for path in maps]
    folder = tempfile.TemporaryDirectory(prefix="fuzz_dbc_")

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        return mutated_text(rng, texts[item % 2], [texts[item % 2], _WORDS]), f".{item % 2}"

    def use(path: Path) -> None:
        channel_map = Path(folder.name) / maps[int(path.suffix[1:])].name
        shutil.copyfile(maps[int(path.suffix[1:])], channel_map)
        shutil.copyfile(path, channel_map.with_suffix(".dbc"))
        _open_and_decode(channel_map)

    return file_run("dbc", seed, make, use)


def make_maps(seed: int) -> Run:
    """A channel map that was changed, beside its DBC file."""
    maps = [config_path(f"can/{name}.yaml") for name in _NAMES]
    texts = [path.read_text(encoding="utf-8") for path in maps]
    folder = tempfile.TemporaryDirectory(prefix="fuzz_map_")
    for path in maps:
        shutil.copyfile(path.with_suffix(".dbc"), Path(folder.name) / f"{path.stem}.dbc")

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        text = texts[item % 2]
        return (mutated_yaml(rng, text) if item % 3 else mutated_text(rng, text)), ".yaml"

    def use(path: Path) -> None:
        channel_map = Path(folder.name) / "map.yaml"
        shutil.copyfile(path, channel_map)
        _open_and_decode(channel_map)

    return file_run("maps", seed, make, use)


def make_calibrations(seed: int) -> Run:
    """A calibration that was changed."""
    channel_map, database = open_channel_map(_NAMES[0])
    text = _calibration(channel_map)

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        return (mutated_yaml(rng, text) if item % 2 else mutated_text(rng, text)), ".yaml"

    def use(path: Path) -> None:
        found = calibrated(channel_map, database, load_calibration(path), str(path))
        for channel in found.channels.values():
            if not np.isfinite([channel.scale_n_per_unit, channel.zero]).all():
                raise FalseAnswerError(f"a calibration of {channel}")

    return file_run("calibrations", seed, make, use)


def _open_and_decode(path: Path) -> None:
    channel_map, database = open_channel_map(path)
    ledger = FaultLedger()
    decoder = FrameDecoder(channel_map, database, ledger)
    low, high = channel_map.range_n
    for message in database.messages:
        for fill in (b"\x00", b"\xff", b"\x7f", b"\x80"):
            if message.length > 8:
                continue
            frame = can.Message(
                arbitration_id=message.frame_id,
                is_extended_id=message.is_extended_frame,
                data=fill * message.length,
            )
            decoded = decoder.decode(frame)
            if decoded is None or decoded.spoilt:
                continue
            for _, tension_n in decoded.readings:
                if not low < tension_n < high:
                    raise FalseAnswerError(f"a reading of {tension_n} N outside {low} … {high}")


def _calibration(channel_map: ChannelMap) -> str:
    lines = ["map: twelve_channel_amplifier", "made: 2026-01-02T03:04:05Z", "gravity_m_s2: 9.81"]
    lines.append("cables:")
    for cable, channel in channel_map.channels.items():
        lines.append(
            f"  {cable}: {{message: {channel.message}, signal: {channel.signal}, "
            "signal_unit: N, signal_factor: 0.1, signal_offset: 0.0, scale_n_per_unit: 1.01, "
            "zero: 0.2, points: 5}"
        )
    return "\n".join(lines) + "\n"
