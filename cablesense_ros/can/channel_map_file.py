"""Channel maps as files: bundled ones by name, any other by path; YAML is data and bounded."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from cablesense_msgs_py.bounded_file import read_bounded_text
from cablesense_msgs_py.plain_yaml import parse_plain_mapping
from cablesense_ros.can.channel_map import ChannelMap, ChannelMapError
from cablesense_sim.arm_problem import describe_problem
from cablesense_sim.config_files import config_path

MAX_MAP_BYTES = 200_000
"""A map is a page of text."""

MAX_DBC_BYTES = 2_000_000
"""A car's whole DBC file is a megabyte."""

MAP_SUFFIXES = (".yaml", ".yml")


def bundled_maps() -> list[str]:
    """Names of the bundled maps, for example `twelve_channel_amplifier`."""
    return sorted(path.stem for path in config_path("can").glob("*.yaml"))


def find_channel_map(name_or_path: str | Path) -> Path:
    """The file that a name (`cia404_amplifier`) or a path (`my/map.yaml`) stands for.

    Raises:
        ChannelMapError: neither a bundled map nor the path of a .yaml file.
    """
    if str(name_or_path) in bundled_maps():
        return config_path(f"can/{name_or_path}.yaml")
    path = Path(name_or_path)
    if path.suffix in MAP_SUFFIXES:
        return path
    raise ChannelMapError(
        f"unknown channel map {str(name_or_path)[:80]!r}; bundled maps are "
        f"{', '.join(bundled_maps())}, and any other is given as the path of its .yaml file"
    )


def load_channel_map(name_or_path: str | Path) -> tuple[ChannelMap, Path]:
    """Read a map; give it and the path of the DBC file beside it, which is not read yet.

    Raises:
        ChannelMapError: the file cannot be found or read, is not YAML, has an unknown key or a
            value that cannot be true.
    """
    path = find_channel_map(name_or_path)
    text = read_bounded_text(path, MAX_MAP_BYTES, "a channel map", ChannelMapError)
    channel_map = parse_channel_map(text, source=str(path))
    return channel_map, path.parent / channel_map.dbc


def parse_channel_map(text: str, source: str = "channel map") -> ChannelMap:
    """Read a map from YAML text; `source` names it in errors.

    Raises:
        ChannelMapError: as `load_channel_map`.
    """
    keys = ", ".join(ChannelMap.model_fields)
    content = parse_plain_mapping(text, source, keys, ChannelMapError)
    try:
        return ChannelMap.model_validate(content)
    except ValidationError as error:
        raise ChannelMapError(f"{source}: {describe_problem(error, ChannelMap)}") from None
