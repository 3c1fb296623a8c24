"""Where the demo's tensions come from: the sim node at once, or through CAN frames."""

from __future__ import annotations

from enum import Enum, StrEnum
from pathlib import Path

from cablesense_msgs_py import topics
from cablesense_ros.processes import node_command

DEMO_MAP = "twelve_channel_amplifier"
"""The amplifier that the emulator poses as."""

_BITRATE_BIT_S = 1_000_000


class Source(StrEnum):
    """The sources; the value is what the command line calls them."""

    SIM = "sim"
    CAN = "can"


def source_commands(source: Source, arm: str, seed: int, folder: Path) -> dict[str, list[str]]:
    """The nodes that publish `cable_tensions`.

    Args:
        source: the sim alone, or the sim, an emulated amplifier and the driver that reads it.
        arm: name or path.
        seed: of the noise.
        folder: where the link to the emulated adapter is put.
    """
    simulation: dict[str, str | int] = {"arm": arm, "seed": seed}
    if source is Source.SIM:
        return {"sim": node_command("sim", simulation)}
    amplifier: dict[str, str | int] = {
        "arm": arm,
        "map": DEMO_MAP,
        "channel": str(folder.resolve() / "can_adapter"),
    }
    adapter: dict[str, str | int] = {"interface": "slcan", "bitrate_bit_s": _BITRATE_BIT_S}
    remaps = {topics.CABLE_TENSIONS: topics.SIMULATED_TENSIONS}
    return {
        "can_emulator": node_command("can_emulator", amplifier),
        "can_driver": node_command("can_driver", {**amplifier, **adapter}),
        "sim": node_command("sim", simulation, remaps),
    }


class Controller(Enum):
    """Nothing but the person at the page, or a controller."""

    NONE = "none"
    ADMITTANCE = "admittance"
