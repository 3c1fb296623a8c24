"""Calibrations as YAML files: data, bounded in size, written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import yaml
from pydantic import ValidationError

from cablesense_msgs_py.bounded_file import read_bounded_text
from cablesense_msgs_py.plain_yaml import parse_plain_mapping
from cablesense_ros.can.calibration import Calibration
from cablesense_ros.can.channel_map import ChannelMapError
from cablesense_ros.can.channel_map_file import MAX_MAP_BYTES
from cablesense_sim.arm_problem import describe_problem

_HEAD = """\
# Scale and zero of tension sensors, from known loads. Give it to the driver as -p calibration:=…
# tension_n = scale_n_per_unit * (value - zero); every *_u95 is an expanded uncertainty (95 %).
"""


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration.

    Raises:
        ChannelMapError: the file cannot be read, is not YAML, or has a key or value that
            cannot be.
    """
    text = read_bounded_text(path, MAX_MAP_BYTES, "a calibration", ChannelMapError)
    keys = ", ".join(Calibration.model_fields)
    content = parse_plain_mapping(text, str(path), keys, ChannelMapError)
    try:
        return Calibration.model_validate(content)
    except ValidationError as error:
        raise ChannelMapError(f"{path}: {describe_problem(error, Calibration)}") from None


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration.

    Raises:
        ChannelMapError: the place cannot be written to.
    """
    path = Path(path)
    content = calibration.model_dump(mode="json", exclude_none=True)
    text = _HEAD + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
    beside = path.parent / f".{path.name}.{os.getpid()}.part"
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    except OSError as error:
        raise ChannelMapError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        beside.unlink(missing_ok=True)
